/* At a steep pitch Euler rates change much within a sample: the attitude takes the angles of the exact rotation. */
static void turn_steep(const $real *x, const $real *rates, $real *next)
{
    $real turned[3], sin_phi, cos_phi, sin_theta, cos_theta, d, e, f, g, w, i, j, k, right, down;
    const $real a = $half * $dt * x[3], b = $half * $dt * x[4], c = $half * $dt * x[5];
    if (absolute(x[1]) <= $steep)
        return;
    sin_cos($half * x[0], &sin_phi, &cos_phi);
    sin_cos($half * x[1], &sin_theta, &cos_theta);
    d = cos_phi * cos_theta, e = sin_phi * cos_theta, f = cos_phi * sin_theta, g = sin_phi * sin_theta;
    w = d - e * a - f * b + g * c;
    i = d * a + e + f * c + g * b;
    j = d * b - e * c + f - g * a;
    k = d * c + e * b - f * a - g;
    right = $two * (j * k + w * i);
    down = w * w - i * i - j * j + k * k;
    turned[0] = arctan2(right, down);
    sin_cos(turned[0], &sin_phi, &cos_phi);
    turned[1] = arctan2($two * (w * j - i * k), right * sin_phi + down * cos_phi) - x[1];
    turned[2] = arctan2($two * (i * j + w * k), w * w + i * i - j * j - k * k);
    turned[0] = ${prefix}_nearest(turned[0], x[0]) - x[0];
    for (int n = 0; n < 3; n++)
        next[n] = next[n] + (turned[n] - $dt * $euler_rate);
}
