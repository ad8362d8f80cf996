/**
 * What the mode of law '$name' holds
 *
 * Level: hover thrust, as long as nothing else sends attitude set-points.
 * Set-points of attitude or trajectory from elsewhere, as over DDS, are followed with any choice but sticks.
 *
 * @value 0 Level
 * @value 1 Level and height
 * @value 2 Position and height
 * @value 3 Sticks
 * @group Gustproof
 */
PARAM_DEFINE_INT32(GP_HOLD, $hold);

/**
 * Roll torque of the torque set-point 1
 *
 * 0: that of the law's vehicle
 *
 * @unit Nm
 * @min 0
 * @decimal 4
 * @group Gustproof
 */
PARAM_DEFINE_FLOAT(GP_TRQ_ROLL, 0.f);

/**
 * Pitch torque of the torque set-point 1
 *
 * 0: that of the law's vehicle
 *
 * @unit Nm
 * @min 0
 * @decimal 4
 * @group Gustproof
 */
PARAM_DEFINE_FLOAT(GP_TRQ_PITCH, 0.f);

/**
 * Yaw torque of the torque set-point 1
 *
 * 0: that of the law's vehicle
 *
 * @unit Nm
 * @min 0
 * @decimal 4
 * @group Gustproof
 */
PARAM_DEFINE_FLOAT(GP_TRQ_YAW, 0.f);
