/* Law '$name' as the Crazyflie's controller: attitude by the law, position by the firmware; by gustproof $version. */
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "FreeRTOS.h"
#include "task.h"

#include "app.h"
#include "controller.h"
#include "log.h"
#include "math3d.h"
#include "param.h"
#include "position_controller.h"
#include "power_distribution.h"
#include "stabilizer_types.h"

#define DEBUG_MODULE "GUSTPROOF"
#include "debug.h"

#include "gustproof_inside.h"

_Static_assert(RATE_MAIN_LOOP % GUSTPROOF_RATE == 0, "the rate of the law must divide the main loop's");

static struct gustproof_inside law;
static struct gustproof_sample now;
static setpoint_mode_t mode_before;
static attitude_t desired; // [deg] as set-points count it: yaw to the left
static float thrust;       // as the firmware counts it, 0 to UINT16_MAX
static float torque[3];    // [N m] about forward, right, down
static bool started;
static uint32_t restarts;

void appMain(void)
{
    DEBUG_PRINT("law $name, %d Hz\n", GUSTPROOF_RATE);
    while (true) {
        vTaskDelay(M2T(10000));
    }
}

void controllerOutOfTreeInit(void)
{
    positionControllerInit();
    started = false;
    thrust = 0.0f;
}

bool controllerOutOfTreeTest(void)
{
    return true;
}

/* Turn a quaternion from forward, left, up axes to forward, right, down axes. */
static void turned(const quaternion_t *q, float into[4])
{
    into[0] = q->w;
    into[1] = q->x;
    into[2] = -q->y;
    into[3] = -q->z;
}

static void begin(const state_t *state)
{
    positionControllerResetAllPID(state->position.x, state->position.y, state->position.z);
    positionControllerResetAllfilters();
    desired.roll = desired.pitch = 0.0f;
    desired.yaw = state->attitude.yaw;
}

static void choose_yaw(const setpoint_t *setpoint)
{
    if (setpoint->mode.yaw == modeVelocity) {
        desired.yaw += setpoint->attitudeRate.yaw / (float)GUSTPROOF_RATE;
        desired.yaw -= 360.0f * roundf(desired.yaw / 360.0f);
    } else if (setpoint->mode.yaw == modeAbs) {
        desired.yaw = setpoint->attitude.yaw;
    } else if (setpoint->mode.quat == modeAbs) {
        const quaternion_t *q = &setpoint->attitudeQuaternion;
        desired.yaw = degrees(quat2rpy(mkquat(q->x, q->y, q->z, q->w)).z);
    }
}

static void choose_tilt_and_thrust(const setpoint_t *setpoint, const state_t *state, const stabilizerStep_t step)
{
    if (memcmp(&setpoint->mode, &mode_before, sizeof(mode_before)) != 0) {
        mode_before = setpoint->mode;
        begin(state);
    }
    if (RATE_DO_EXECUTE(POSITION_RATE, step)) {
        positionController(&thrust, &desired, setpoint, state);
    }
    if (setpoint->mode.z == modeDisable) {
        thrust = setpoint->thrust;
    }
    if (setpoint->mode.x == modeDisable || setpoint->mode.y == modeDisable) {
        desired.roll = setpoint->attitude.roll;
        desired.pitch = setpoint->attitude.pitch;
    }
}

static void read_sensors(const sensorData_t *sensors, const state_t *state)
{
    const struct quat target = rpy2quat(mkvec(radians(desired.roll), -radians(desired.pitch), radians(desired.yaw)));
    const quaternion_t wanted = {.x = target.x, .y = target.y, .z = target.z, .w = target.w};
    const float *gyro = sensors->gyro.axis, *acc = sensors->acc.axis;
    for (int i = 0; i < 3; i++) {
        const float sign = i == 0 ? 1.0f : -1.0f;
        now.gyro[i] = sign * radians(gyro[i]);
        now.force[i] = sign * 9.80665f * acc[i];
    }
    turned(&state->attitudeQuaternion, now.attitude);
    turned(&wanted, now.reference);
    now.elapsed = 1.0f / GUSTPROOF_RATE;
}

static void step_law(void)
{
    if (!started || thrust <= 0.0f) { // or its integrators would wind up against the ground
        gustproof_start(&law, &now);
        started = true;
    }
    restarts += gustproof_run(&law, &now, torque);
}

void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                         const state_t *state, const stabilizerStep_t step)
{
    control->controlMode = controlModeForceTorque;
    choose_tilt_and_thrust(setpoint, state, step);
    if (RATE_DO_EXECUTE(GUSTPROOF_RATE, step)) {
        choose_yaw(setpoint);
        read_sensors(sensors, state);
        step_law();
    }
    if (thrust <= 0.0f) {
        begin(state);
        memset(torque, 0, sizeof(torque));
    }
    control->thrustSi = fmaxf(thrust, 0.0f) / (float)UINT16_MAX * powerDistributionGetMaxThrust();
    control->torqueX = torque[0];
    control->torqueY = -torque[1];
    control->torqueZ = -torque[2];
}

LOG_GROUP_START(gustproof)
LOG_ADD(LOG_FLOAT, roll, &torque[0])
LOG_ADD(LOG_FLOAT, pitch, &torque[1])
LOG_ADD(LOG_FLOAT, yaw, &torque[2])
LOG_ADD(LOG_UINT32, restarts, &restarts)
LOG_GROUP_STOP(gustproof)
