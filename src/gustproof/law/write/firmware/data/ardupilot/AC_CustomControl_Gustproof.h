// Law '$name' in place of the attitude and rate controllers; by gustproof $version.
#pragma once

#include "AC_CustomControl_Backend.h"

#if AP_CUSTOMCONTROL_ENABLED

#include "gustproof_inside.h"

class AC_CustomControl_Gustproof : public AC_CustomControl_Backend {
public:
    AC_CustomControl_Gustproof(AC_CustomControl& frontend, AP_AHRS_View*& ahrs, AC_AttitudeControl*& att_control, AP_MotorsMulticopter*& motors, float dt);

    Vector3f update(void) override;
    void reset(void) override;

    static const struct AP_Param::GroupInfo var_info[];

private:
    Vector3f full_torque(void) const;
    void tell_saturation(const Vector3f &full);
    void read_sensors(void);
    void start(void);

    AP_Float _roll_torque;
    AP_Float _pitch_torque;
    AP_Float _yaw_torque;

    gustproof_inside _law;
    gustproof_sample _now;
    Vector3f _input; // of the motors, as it was last asked for
    uint8_t _mode;   // of the vehicle when it was switched to this controller
    bool _fits;      // the loop runs at the rate of the law
};

#endif  // AP_CUSTOMCONTROL_ENABLED
