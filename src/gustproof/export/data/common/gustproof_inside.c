/* Law '$name' inside an autopilot; see gustproof_inside.h. */
#include "gustproof_inside.h"

#include <math.h>

static void euler_of(const float q[4], $real euler[3])
{
    const float s = 2.0f * (q[0] * q[2] - q[3] * q[1]);
    euler[0] = ($real)atan2f(2.0f * (q[0] * q[1] + q[2] * q[3]), 1.0f - 2.0f * (q[1] * q[1] + q[2] * q[2]));
    euler[1] = ($real)asinf(s > 1.0f ? 1.0f : s < -1.0f ? -1.0f : s);
    euler[2] = ($real)atan2f(2.0f * (q[0] * q[3] + q[1] * q[2]), 1.0f - 2.0f * (q[2] * q[2] + q[3] * q[3]));
}

/* Write an attitude as the law counts it, with the yaw nearest to the law's own. */
static void counted(const struct gustproof_inside *law, const float q[4], $real euler[3])
{
    euler_of(q, euler);
    for (int i = 0; i < 3; i++)
        euler[i] -= law->origin[i];
    euler[2] = ${prefix}_nearest(euler[2], $yaw);
}

static int sound(const float torque[3])
{
    int all = 1;
    for (int i = 0; i < 3; i++)
        all &= torque[i] >= -1e6f && torque[i] <= 1e6f;
    return all;
}

void gustproof_start(struct gustproof_inside *law, const float attitude[4], const float gyro[3])
{
    $real euler[3], rates[3];
    euler_of(attitude, euler);
    for (int i = 0; i < 3; i++) {
        law->origin[i] = i < $first ? ($real)0 : euler[i];
        euler[i] -= law->origin[i];
        rates[i] = ($real)gyro[i];
        law->torque[i] = 0.0f;
    }
    ${prefix}_start(law->x, euler, rates);
    law->waited = 0.0f;
}

int gustproof_run(struct gustproof_inside *law, float elapsed, const float gyro[3], const float force[3],
                  const float attitude[4], const float reference[4], float torque[3])
{
    const float dt = (float)${prefix}_DT;
    int restarted = 0;
    $real y[${prefix}_MEASURED], command[3];
    law->waited += elapsed;
    if (!(law->waited < $makeup.5f * dt)) {
        gustproof_start(law, attitude, gyro);
        law->waited = dt;
        restarted = 1;
    }
    for (; law->waited > 0.5f * dt; law->waited -= dt) {
        for (int i = 0; i < 3; i++)
            y[i] = ($real)gyro[i];
        counted(law, reference, y + 3);
$more        (void)${prefix}_step(law->x, y, command);
        for (int i = 0; i < 3; i++)
            law->torque[i] = (float)command[i];
    }
    if (!sound(law->torque)) {
        gustproof_start(law, attitude, gyro);
        restarted = 1;
    }
    for (int i = 0; i < 3; i++)
        torque[i] = law->torque[i];
    return restarted;
}

void gustproof_undelivered(struct gustproof_inside *law, const float missing[3])
{
    const $real told[3] = {($real)missing[0], ($real)missing[1], ($real)missing[2]};
    ${prefix}_undelivered(law->x, told);
}
