static float absolute(float x)
{
    return x < 0.0f ? -x : x;
}

/* Euler rates minus body rates, exact ZYX kinematics at the law's own estimates; |cos(theta)| is kept above 0.05. */
static void euler_excess(const float *x, float *rates)
{
    float sin_phi, flat_phi, sin_theta, flat_theta, cos_theta, psi_dot;
    sin_versine(x[0], &sin_phi, &flat_phi);
    sin_versine(x[1], &sin_theta, &flat_theta);
    cos_theta = 1.0f - flat_theta;
    if (absolute(cos_theta) < 0.05f) {
        cos_theta = cos_theta >= 0.0f ? 0.05f : -0.05f;
        flat_theta = 1.0f - cos_theta;
    }
    psi_dot = (sin_phi * x[4] + (1.0f - flat_phi) * x[5]) / cos_theta;
    rates[0] = sin_theta * psi_dot;
    rates[1] = -flat_phi * x[4] - sin_phi * x[5];
    rates[2] = (sin_phi * x[4] + (flat_theta - flat_phi) * x[5]) / cos_theta;
}
