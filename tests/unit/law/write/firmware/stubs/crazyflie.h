/* Declarations of what the generated app uses of the Crazyflie's firmware: names and types alone, nothing of its code. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#define RATE_MAIN_LOOP 1000
#define POSITION_RATE 100
#define RATE_DO_EXECUTE(rate, step) ((step) % (RATE_MAIN_LOOP / (rate)) == 0)
#define M2T(ms) ((uint32_t)(ms))
#define DEBUG_PRINT(...) stub_print(__VA_ARGS__)
#define LOG_GROUP_START(name) const void *const name##_log[] = {
#define LOG_ADD(type, name, address) address,
#define LOG_GROUP_STOP(name) 0};

void stub_print(const char *format, ...) __attribute__((format(printf, 1, 2)));
void vTaskDelay(uint32_t ticks);
void appMain(void);

typedef uint32_t stabilizerStep_t;
typedef union { struct { float x, y, z; }; float axis[3]; } Axis3f;
typedef struct { float x, y, z; } point_t;
typedef struct { float x, y, z, w; } quaternion_t;
typedef struct { float roll, pitch, yaw; } attitude_t;
typedef struct { Axis3f acc, gyro; } sensorData_t;
typedef struct { attitude_t attitude; quaternion_t attitudeQuaternion; point_t position; } state_t;
typedef enum { modeDisable, modeAbs, modeVelocity } stab_mode_t;
typedef struct { stab_mode_t x, y, z, roll, pitch, yaw, quat; } setpoint_mode_t;
typedef struct {
    attitude_t attitude, attitudeRate;
    quaternion_t attitudeQuaternion;
    float thrust;
    setpoint_mode_t mode;
} setpoint_t;
typedef enum { controlModeLegacy, controlModeForceTorque } control_mode_t;
typedef struct { float thrustSi, torqueX, torqueY, torqueZ; control_mode_t controlMode; } control_t;
struct vec { float x, y, z; };
struct quat { float x, y, z, w; };

struct vec mkvec(float x, float y, float z);
struct quat mkquat(float x, float y, float z, float w);
struct quat rpy2quat(struct vec rpy);
struct vec quat2rpy(struct quat q);
float radians(float degrees), degrees(float radians);
float powerDistributionGetMaxThrust();
void positionControllerInit();
void positionControllerResetAllPID(float x, float y, float z);
void positionControllerResetAllfilters();
void positionController(float *thrust, attitude_t *attitude, const setpoint_t *setpoint, const state_t *state);
void controllerOutOfTreeInit(void);
bool controllerOutOfTreeTest(void);
void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                         const state_t *state, const stabilizerStep_t step);
