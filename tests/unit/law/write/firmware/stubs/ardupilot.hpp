// Declarations of what the generated backend uses of ArduPilot: names and types alone, nothing of its code.
#pragma once

#include <cstdint>

#define AP_CUSTOMCONTROL_ENABLED 1
#define AP_GROUPINFO(name, index, type, element, value) { name, index, &type::element ? value : value }
#define AP_GROUPEND { nullptr, 0, 0.0f }
#define GCS_SEND_TEXT(severity, ...) stub_text(__VA_ARGS__)

void stub_text(const char *format, ...) __attribute__((format(printf, 1, 2)));
float constrain_float(float, float, float);

struct AP_Float { operator float() const; };
struct AP_Param {
    struct GroupInfo { const char *name; uint8_t index; float value; };
    static void setup_object_defaults(void *, const GroupInfo *);
};
struct Vector3f {
    float x, y, z;
    Vector3f();
    Vector3f(float, float, float);
    Vector3f operator*(float) const;
    Vector3f operator-(const Vector3f &) const;
    Vector3f &operator+=(const Vector3f &);
    void zero();
};
struct Quaternion { float q1, q2, q3, q4; };
struct AP_AHRS_View { void get_quat_body_to_ned(Quaternion &) const; Vector3f get_gyro_latest() const; };
struct AC_AttitudeControl { Quaternion get_attitude_target_quat() const; };
struct Thrust_Linearization { float get_spin_max() const, get_spin_min() const, get_compensation_gain() const; };
struct AP_Motors {
    enum class SpoolState { SHUT_DOWN, GROUND_IDLE, SPOOLING_UP, THROTTLE_UNLIMITED, SPOOLING_DOWN };
    struct { bool roll, pitch, yaw; } limit;
    float get_roll() const, get_pitch() const, get_yaw() const;
    SpoolState get_spool_state() const;
};
struct AP_MotorsMulticopter : AP_Motors { Thrust_Linearization thr_lin; bool get_thrust(uint8_t, float &) const; };
struct AP_AHRS { const Vector3f &get_accel() const; };
struct AP_Scheduler { uint16_t get_loop_rate_hz(); };
struct AP_Vehicle { virtual ~AP_Vehicle(); virtual uint8_t get_mode() const = 0; };
namespace AP { AP_AHRS &ahrs(); AP_Scheduler &scheduler(); AP_Vehicle *vehicle(); }

struct AC_CustomControl { void set_custom_controller(bool); };
class AC_CustomControl_Backend
{
public:
    AC_CustomControl_Backend(AC_CustomControl &frontend, AP_AHRS_View *&ahrs, AC_AttitudeControl *&control, AP_MotorsMulticopter *&motors, float) :
        _frontend(frontend), _ahrs(ahrs), _att_control(control), _motors(motors) {}
    virtual ~AC_CustomControl_Backend() {}
    virtual Vector3f update() = 0;
    virtual void reset() = 0;
protected:
    AC_CustomControl &_frontend;
    AP_AHRS_View *&_ahrs;
    AC_AttitudeControl *&_att_control;
    AP_MotorsMulticopter *&_motors;
};
