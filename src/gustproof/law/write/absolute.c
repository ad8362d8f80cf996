static double absolute(double x)
{
    return x < 0.0 ? -x : x;
}
