/* Law '$name' inside an autopilot: one gyro sample after the other, from a start at the present attitude.
 *
 * By gustproof $version. Attitudes are quaternions (w, x, y, z) from body (forward, right, down) to north, east, down.
 * Torque [N m], rates [rad/s] and specific force [m/s^2] are about and along the body axes.
 */
#ifndef GUSTPROOF_INSIDE_H
#define GUSTPROOF_INSIDE_H

#include "gustproof_law.h"

/* [Hz] samples of the gyro that the law needs */
#define GUSTPROOF_RATE $rate

#ifdef __cplusplus
extern "C" {
#endif

struct gustproof_inside {
    $real x[${prefix}_STATES];
    $real origin[3]; /* [rad] roll, pitch, yaw that the law counts its attitude from: $origin */
    float waited;     /* [s] since the last step */
    float torque[3];  /* of the last step */
    float trim[3];    /* [N m] on top of it: torque of the loops before, on its way out */
};

struct gustproof_sample {
    float elapsed;      /* [s] since the sample before */
    float gyro[3];
    float force[3];     /* used by laws with accelerometer */
    float attitude[4];
    float age;          /* [s] of that attitude at the time of the gyro sample */
    float reference[4]; /* attitude to hold */
};

/* Start at the attitude of a sample; while on the ground or disarmed, at every sample. */
void gustproof_start(struct gustproof_inside *law, const struct gustproof_sample *now);

/* Begin with the torque [N m] of the loops that flew until the start: without it a steady moment turns the vehicle.
 *
 * It fades out in some seconds, as the law's own integrators take over.
 */
void gustproof_take_over(struct gustproof_inside *law, const float torque[3]);

/* Run one sample and write the torque.
 *
 * A lost sample is made up for by steps with the present one, $makeup at most. After a longer gap, or if the law gives
 * a number that is not finite, it starts again at the present attitude; then 1 is returned, else 0.
 */
int gustproof_run(struct gustproof_inside *law, const struct gustproof_sample *now, float torque[3]);

/* Tell what of the last torque the vehicle did not deliver: delivered minus commanded [N m]. */
void gustproof_undelivered(struct gustproof_inside *law, const float missing[3]);

#ifdef __cplusplus
}
#endif

#endif
