// Law '$name' in place of the attitude and rate controllers; by gustproof $version.
#if !__has_include("AC_CustomControl_config.h")
#error "this law needs ArduCopter 4.6 or later: earlier ones do not tell the thrust of a motor"
#endif
#include "AC_CustomControl_config.h"

#if AP_CUSTOMCONTROL_ENABLED

#include "AC_CustomControl_Gustproof.h"

#include <AC_AttitudeControl/AC_AttitudeControl.h>
#include <AP_AHRS/AP_AHRS.h>
#include <AP_Motors/AP_MotorsMatrix.h>
#include <AP_Scheduler/AP_Scheduler.h>
#include <AP_Vehicle/AP_Vehicle.h>
#include <GCS_MAVLink/GCS.h>

const AP_Param::GroupInfo AC_CustomControl_Gustproof::var_info[] = {
    // @Param: TRQ_RLL
    // @DisplayName: Roll torque of the motor input 1
    // @Description: Roll torque of the motor input 1 at sea level, if the motors span no thrust to full thrust
    // @Units: N.m
    // @User: Advanced
    AP_GROUPINFO("TRQ_RLL", 1, AC_CustomControl_Gustproof, _roll_torque, $roll_torque),

    // @Param: TRQ_PIT
    // @DisplayName: Pitch torque of the motor input 1
    // @Description: Pitch torque of the motor input 1 at sea level, if the motors span no thrust to full thrust
    // @Units: N.m
    // @User: Advanced
    AP_GROUPINFO("TRQ_PIT", 2, AC_CustomControl_Gustproof, _pitch_torque, $pitch_torque),

    // @Param: TRQ_YAW
    // @DisplayName: Yaw torque of the motor input 1
    // @Description: Yaw torque of the motor input 1 at sea level, if the motors span no thrust to full thrust
    // @Units: N.m
    // @User: Advanced
    AP_GROUPINFO("TRQ_YAW", 3, AC_CustomControl_Gustproof, _yaw_torque, $yaw_torque),

    AP_GROUPEND
};

AC_CustomControl_Gustproof::AC_CustomControl_Gustproof(AC_CustomControl& frontend, AP_AHRS_View*& ahrs, AC_AttitudeControl*& att_control, AP_MotorsMulticopter*& motors, float dt) :
    AC_CustomControl_Backend(frontend, ahrs, att_control, motors, dt),
    _law(),
    _now(),
    _fits(AP::scheduler().get_loop_rate_hz() == GUSTPROOF_RATE)
{
    AP_Param::setup_object_defaults(this, var_info);
}

// called on each switch to this controller
void AC_CustomControl_Gustproof::reset(void)
{
    if (!_fits) {
        GCS_SEND_TEXT(MAV_SEVERITY_CRITICAL, "Gustproof: SCHED_LOOP_RATE must be %d, stock loops fly", GUSTPROOF_RATE);
    } else {
        GCS_SEND_TEXT(MAV_SEVERITY_INFO, "Law '$name' in control"); // the program is known by this text
    }
    _mode = AP::vehicle()->get_mode();
    start();
}

void AC_CustomControl_Gustproof::start(void)
{
    read_sensors();
    gustproof_start(&_law, &_now);
    _input.zero();
}

void AC_CustomControl_Gustproof::read_sensors(void)
{
    Quaternion attitude;
    _ahrs->get_quat_body_to_ned(attitude);
    const Quaternion target = _att_control->get_attitude_target_quat();
    const Vector3f gyro = _ahrs->get_gyro_latest();
    const Vector3f &accel = AP::ahrs().get_accel();
    const float loop = 1.0f / GUSTPROOF_RATE; // attitude is estimated after the motors are told
    _now = {
        loop,
        { gyro.x, gyro.y, gyro.z },
        { accel.x, accel.y, accel.z },
        { attitude.q1, attitude.q2, attitude.q3, attitude.q4 },
        loop,
        { target.q1, target.q2, target.q3, target.q4 }
    };
}

// return roll, pitch and yaw input of the motors
Vector3f AC_CustomControl_Gustproof::update(void)
{
    if (!_fits || AP::vehicle()->get_mode() != _mode) {
        _frontend.set_custom_controller(false); // or it would hold the integrators of the stock loops at 0
        return Vector3f(_motors->get_roll(), _motors->get_pitch(), _motors->get_yaw());
    }

    const Vector3f full = full_torque();
    const AP_Motors::SpoolState spool = _motors->get_spool_state();
    if (spool == AP_Motors::SpoolState::SHUT_DOWN || spool == AP_Motors::SpoolState::GROUND_IDLE) {
        start(); // or its integrators would wind up against the ground
    } else {
        tell_saturation(full);
    }

    read_sensors();
    float torque[3];
    gustproof_run(&_law, &_now, torque);

    _input = Vector3f(torque[0] / full.x, torque[1] / full.y, torque[2] / full.z);
    return Vector3f(constrain_float(_input.x, -1.0f, 1.0f), constrain_float(_input.y, -1.0f, 1.0f), constrain_float(_input.z, -1.0f, 1.0f));
}

// torque of the motor input 1 [N m], with the motors' present range and compensation of air and battery
Vector3f AC_CustomControl_Gustproof::full_torque(void) const
{
    const Thrust_Linearization &motor = _motors->thr_lin;
    const float scale = (motor.get_spin_max() - motor.get_spin_min()) * motor.get_compensation_gain();
    return Vector3f(_roll_torque, _pitch_torque, _yaw_torque) * scale;
}

// the mixer has four motors of a quadrotor X: factors +-1/2, so that their sums with the thrusts are the inputs again
void AC_CustomControl_Gustproof::tell_saturation(const Vector3f &full)
{
    if (!_motors->limit.roll && !_motors->limit.pitch && !_motors->limit.yaw) {
        return;
    }
    static const Vector3f factors[4] { { -0.5f, 0.5f, 0.5f }, { 0.5f, -0.5f, 0.5f }, { 0.5f, 0.5f, -0.5f }, { -0.5f, -0.5f, -0.5f } };
    Vector3f delivered;
    for (uint8_t i = 0; i < 4; i++) {
        float thrust;
        if (!_motors->get_thrust(i, thrust)) {
            return;
        }
        delivered += factors[i] * thrust;
    }
    const Vector3f missing = delivered - _input;
    const float told[3] { missing.x * full.x, missing.y * full.y, missing.z * full.z };
    gustproof_undelivered(&_law, told);
}

#endif  // AP_CUSTOMCONTROL_ENABLED
