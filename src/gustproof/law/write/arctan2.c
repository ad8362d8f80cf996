/* Moshier's rational approximation (Cephes, atan.c); 0 where both are 0. */
static double arctan2(double y, double x)
{
    double a = absolute(x), b = absolute(y), larger = a < b ? b : a, smaller = a < b ? a : b;
    int upper = smaller > 0.66 * larger;
    double t = (upper ? smaller - larger : smaller) / (upper ? smaller + larger : larger > 0.0 ? larger : 1.0);
    double z = t * t;
    double p = (((-8.750608600031904122785e-1 * z - 1.615753718733365076637e1) * z - 7.500855792314704667340e1) * z
        - 1.228866684490136173410e2) * z - 6.485021904942025371773e1;
    double q = ((((z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2) * z + 4.328810604912902668951e2) * z
        + 4.853903996359136964868e2) * z + 1.945506571482613964425e2;
    double angle = t + t * z * p / q + (upper ? 0.7853981633974483 : 0.0);
    angle = b > a ? 1.5707963267948966 - angle : angle;
    angle = x < 0.0 ? 3.141592653589793 - angle : angle;
    return y < 0.0 ? -angle : angle;
}
