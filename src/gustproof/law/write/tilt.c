/* Roll and pitch of a body at rest with this specific force: of the angles for its tilt those nearest to the law's. */
static void tilt_of(const double *force, const double *x, double *tilt)
{
    double sine, cosine, roll = arctan2(-force[1], -force[2]), pitch;
    double half_turns = floor_of(x[1] * 0.3183098861837907 + 0.5);
    double upside_down = half_turns - 2.0 * floor_of(0.5 * half_turns);
    sin_cos(roll, &sine, &cosine);
    pitch = arctan2(force[0], -(force[1] * sine + force[2] * cosine));
    roll += upside_down * 3.141592653589793;
    tilt[0] = ${prefix}_nearest(roll, x[0]);
    tilt[1] = half_turns * 3.141592653589793 + (1.0 - 2.0 * upside_down) * pitch;
}
