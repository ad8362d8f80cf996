/* Sine, and one minus the cosine, without cancellation at small angles: Cody and Waite's reduction, Taylor's series. */
static void sin_versine(float x, float *sine, float *versine)
{
    float n = floor_of(x * 0.63661975f + 0.5f);
    float r = ((x - n * 1.5703125f) - n * 4.837513e-4f) - n * 7.54979e-8f;
    float z = r * r;
    float s = r + r * z * (-0.16666667f + z * (8.3333333e-3f + z * (-1.9841270e-4f + z * 2.7557319e-6f)));
    float v = 0.5f * z + z * z * (-0.041666667f + z * (1.3888889e-3f + z * (-2.4801587e-5f + z * 2.7557319e-7f)));
    int quadrant = (int)(n - 4.0f * floor_of(0.25f * n));
    *sine = quadrant == 0 ? s : quadrant == 1 ? 1.0f - v : quadrant == 2 ? -s : v - 1.0f;
    *versine = quadrant == 0 ? v : quadrant == 1 ? 1.0f + s : quadrant == 2 ? 2.0f - v : 1.0f - s;
}
