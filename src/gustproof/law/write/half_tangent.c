/* Tangent of half an angle within its limit. */
static $real half_tangent($real angle, $real limit)
{
    $real sine, cosine;
    sin_cos(limited(angle, limit), &sine, &cosine);
    return sine / ($one + cosine);
}
