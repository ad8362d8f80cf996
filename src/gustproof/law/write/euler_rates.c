/* Exact ZYX Euler kinematics at the law's own estimates; |cos(theta)| is kept above 0.05. */
static void euler_rates(const double *x, double *rates)
{
    double sin_phi, cos_phi, sin_theta, cos_theta, psi_dot;
    sin_cos(x[0], &sin_phi, &cos_phi);
    sin_cos(x[1], &sin_theta, &cos_theta);
    if (absolute(cos_theta) < 0.05)
        cos_theta = cos_theta >= 0.0 ? 0.05 : -0.05;
    psi_dot = (sin_phi * x[4] + cos_phi * x[5]) / cos_theta;
    rates[0] = x[3] + sin_theta * psi_dot;
    rates[1] = cos_phi * x[4] - sin_phi * x[5];
    rates[2] = psi_dot;
}
