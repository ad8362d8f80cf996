static void sin_cos(float x, float *sine, float *cosine)
{
    sin_versine(x, sine, cosine);
    *cosine = 1.0f - *cosine;
}
