/* Cody and Waite's reduction, then minimax polynomials (Sun Microsystems, fdlibm, k_sin.c and k_cos.c). */
static void sin_cos(double x, double *sine, double *cosine)
{
    double n = floor_of(x * 0.6366197723675814 + 0.5);
    double r = ((x - n * 1.57079632673412561417e00) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
    double z = r * r;
    double s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03
        + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06
        + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    double c = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
        + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07
        + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)))));
    int quadrant = (int)(n - 4.0 * floor_of(0.25 * n));
    int odd = quadrant == 1 || quadrant == 3;
    double a = odd ? c : s, b = odd ? s : c;
    *sine = quadrant >= 2 ? -a : a;
    *cosine = quadrant == 1 || quadrant == 2 ? -b : b;
}
