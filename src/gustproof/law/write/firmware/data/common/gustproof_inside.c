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

/* Write the sample's attitude at the time of its gyro: turned on by the rates for its age. */
static void present_attitude(const struct gustproof_sample *now, $real euler[3])
{
    const float *q = now->attitude, h = 0.5f * now->age;
    const float a = h * now->gyro[0], b = h * now->gyro[1], c = h * now->gyro[2];
    const float scale = 1.0f / sqrtf(1.0f + a * a + b * b + c * c);
    const float turned[4] = {
        scale * (q[0] - a * q[1] - b * q[2] - c * q[3]),
        scale * (q[1] + a * q[0] - b * q[3] + c * q[2]),
        scale * (q[2] + a * q[3] + b * q[0] - c * q[1]),
        scale * (q[3] - a * q[2] + b * q[1] + c * q[0]),
    };
    euler_of(turned, euler);
}

/* Write y: all that a step of the law reads. Attitudes are as the law counts them, with the yaw nearest to its own. */
static void read_sample(const struct gustproof_inside *law, const struct gustproof_sample *now,
                        $real y[${prefix}_MEASURED])
{
    for (int i = 0; i < 3; i++)
        y[i] = ($real)now->gyro[i];
    euler_of(now->reference, y + 3);
$more    for (int i = 0; i < 3; i++)
        y[3 + i] -= law->origin[i];
    y[5] = ${prefix}_nearest(y[5], $yaw);
}

static int sound(const float torque[3])
{
    int all = 1;
    for (int i = 0; i < 3; i++)
        all &= torque[i] >= -1e6f && torque[i] <= 1e6f;
    return all;
}

void gustproof_start(struct gustproof_inside *law, const struct gustproof_sample *now)
{
    $real euler[3], rates[3];
    present_attitude(now, euler);
    for (int i = 0; i < 3; i++) {
        law->origin[i] = i < $first ? ($real)0 : euler[i];
        euler[i] -= law->origin[i];
        rates[i] = ($real)now->gyro[i];
        law->torque[i] = law->trim[i] = 0.0f;
    }
    ${prefix}_start(law->x, euler, rates);
    law->waited = 0.0f;
}

void gustproof_take_over(struct gustproof_inside *law, const float torque[3])
{
    if (!sound(torque))
        return;
    for (int i = 0; i < 3; i++)
        law->trim[i] = torque[i];
}

int gustproof_run(struct gustproof_inside *law, const struct gustproof_sample *now, float torque[3])
{
    const float dt = (float)${prefix}_DT;
    int restarted = 0;
    $real y[${prefix}_MEASURED], command[3] = { 2e6f, 2e6f, 2e6f }; /* not sound: stays where a sample is refused */
    law->waited += now->elapsed;
    if (!(law->waited < $makeup.5f * dt)) {
        gustproof_start(law, now);
        law->waited = dt;
        restarted = 1;
    }
    for (; law->waited > 0.5f * dt; law->waited -= dt) {
        read_sample(law, now, y);
        (void)${prefix}_step(law->x, y, command);
        for (int i = 0; i < 3; i++) {
            law->torque[i] = (float)command[i];
            law->trim[i] -= dt / $fade * law->trim[i];
        }
    }
    if (!sound(law->torque)) {
        gustproof_start(law, now);
        restarted = 1;
    }
    for (int i = 0; i < 3; i++)
        torque[i] = law->torque[i] + law->trim[i];
    return restarted;
}

void gustproof_undelivered(struct gustproof_inside *law, const float missing[3])
{
    const $real told[3] = {($real)missing[0], ($real)missing[1], ($real)missing[2]};
    ${prefix}_undelivered(law->x, told);
}
