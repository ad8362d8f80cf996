/* Moshier's polynomial (Cephes, atanf.c); 0 where both are 0. */
static float arctan2(float y, float x)
{
    float a = absolute(x), b = absolute(y), larger = a < b ? b : a, smaller = a < b ? a : b;
    int upper = smaller > 0.41421357f * larger;
    float t = (upper ? smaller - larger : smaller) / (upper ? smaller + larger : larger > 0.0f ? larger : 1.0f);
    float z = t * t;
    float p = ((8.0537445e-2f * z - 1.3877686e-1f) * z + 1.9977711e-1f) * z - 3.3332950e-1f;
    float angle = t + t * z * p + (upper ? 0.7853982f : 0.0f);
    angle = b > a ? 1.5707964f - angle : angle;
    angle = x < 0.0f ? 3.1415927f - angle : angle;
    return y < 0.0f ? -angle : angle;
}
