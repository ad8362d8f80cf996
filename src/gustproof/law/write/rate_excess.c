/* Excess of the rates commanded from attitude over their limits. They are Euler rates: roll and pitch beyond limits of
 * their own turn them into body rates. Within all limits the excess is 0. */
static void rate_excess(const $real *x, const $real *s, const $real *limits, const $real *angles, $real *excess)
{
    $real p = limited(s[0], limits[0]), q = limited(s[1], limits[1]), r = limited(s[2], limits[2]);
    $real sin_phi, cos_phi, sin_theta, cos_theta, across;
    sin_cos(x[0] - limited(x[0], angles[0]), &sin_phi, &cos_phi);
    sin_cos(x[1] - limited(x[1], angles[1]), &sin_theta, &cos_theta);
    across = cos_theta * r;
    excess[0] = p - sin_theta * r - s[0];
    excess[1] = cos_phi * q + sin_phi * across - s[1];
    excess[2] = cos_phi * across - sin_phi * q - s[2];
}
