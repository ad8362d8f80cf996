/* A mode that flies law '$name' in place of PX4's attitude and rate loops; by gustproof $version. */
#pragma once

#include "GustproofModule.hpp"
#include "gustproof_inside.h"

#include <px4_platform_common/module_params.h>
#include <px4_platform_common/px4_work_queue/WorkItem.hpp>
#include <uORB/Publication.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/SubscriptionCallback.hpp>
#include <uORB/SubscriptionInterval.hpp>
#include <uORB/topics/arming_check_reply.h>
#include <uORB/topics/arming_check_request.h>
#include <uORB/topics/control_allocator_status.h>
#include <uORB/topics/debug_array.h>
#include <uORB/topics/parameter_update.h>
#include <uORB/topics/register_ext_component_reply.h>
#include <uORB/topics/register_ext_component_request.h>
#include <uORB/topics/trajectory_setpoint.h>
#include <uORB/topics/unregister_ext_component.h>
#include <uORB/topics/vehicle_acceleration.h>
#include <uORB/topics/vehicle_angular_velocity.h>
#include <uORB/topics/vehicle_attitude.h>
#include <uORB/topics/vehicle_attitude_setpoint.h>
#include <uORB/topics/vehicle_control_mode.h>
#include <uORB/topics/vehicle_land_detected.h>
#include <uORB/topics/vehicle_local_position.h>
#include <uORB/topics/vehicle_thrust_setpoint.h>
#include <uORB/topics/vehicle_torque_setpoint.h>

class Gustproof;
using GustproofModule = decltype(module_kind<ModuleBase, Gustproof>())::Type;

class Gustproof : public GustproofModule, public ModuleParams, public px4::WorkItem
{
public:
	Gustproof();
	~Gustproof() override = default;

	static int task_spawn(int argc, char *argv[]);
	static int custom_command(int argc, char *argv[]);
	static int print_usage(const char *reason = nullptr);

	int print_status() override;
	bool init();

private:
	enum class Hold : int32_t { level, height, position, sticks };

	void Run() override;

	void check_parameters();
	void watch_rate(float interval);
	void register_mode(hrt_abstime now);
	void unregister_mode();
	void configure_mode();
	void answer_arming_check();
	bool in_control();
	float full_torque(int axis) const; // [N m] of the torque set-point 1
	void enter();
	void follow_torque(float interval);
	void take_over();
	void choose_setpoint(hrt_abstime now);
	void tell_saturation(hrt_abstime now);
	void read_sensors(const vehicle_angular_velocity_s &gyro, float interval);
	void fly(hrt_abstime sample);
	void publish(const float torque[3], hrt_abstime sample);

	Hold hold() const { return static_cast<Hold>(_param_hold.get()); }

	uORB::SubscriptionCallbackWorkItem _gyro_sub{this, ORB_ID(vehicle_angular_velocity)};
	uORB::Subscription _acceleration_sub{ORB_ID(vehicle_acceleration)};
	uORB::Subscription _attitude_sub{ORB_ID(vehicle_attitude)};
	uORB::Subscription _attitude_setpoint_sub{ORB_ID(vehicle_attitude_setpoint)};
	uORB::Subscription _allocator_sub{ORB_ID(control_allocator_status)};
	uORB::Subscription _array_sub{ORB_ID(debug_array)};
	uORB::Subscription _control_mode_sub{ORB_ID(vehicle_control_mode)};
	uORB::Subscription _land_sub{ORB_ID(vehicle_land_detected)};
	uORB::Subscription _position_sub{ORB_ID(vehicle_local_position)};
	uORB::Subscription _torque_sub{ORB_ID(vehicle_torque_setpoint)};
	uORB::Subscription _trajectory_sub{ORB_ID(trajectory_setpoint)};
	uORB::Subscription _check_sub{ORB_ID(arming_check_request)};
	uORB::Subscription _registered_sub{ORB_ID(register_ext_component_reply)};
	uORB::SubscriptionInterval _parameter_sub{ORB_ID(parameter_update), 1000000};

	uORB::Publication<arming_check_reply_s> _check_pub{ORB_ID(arming_check_reply)};
	uORB::Publication<register_ext_component_request_s> _register_pub{ORB_ID(register_ext_component_request)};
	uORB::Publication<unregister_ext_component_s> _unregister_pub{ORB_ID(unregister_ext_component)};
	uORB::Publication<vehicle_control_mode_s> _configure_pub{ORB_ID(config_control_setpoints)};
	uORB::Publication<trajectory_setpoint_s> _trajectory_pub{ORB_ID(trajectory_setpoint)};
	uORB::Publication<vehicle_thrust_setpoint_s> _thrust_pub{ORB_ID(vehicle_thrust_setpoint)};
	uORB::Publication<vehicle_torque_setpoint_s> _torque_pub{ORB_ID(vehicle_torque_setpoint)};

	gustproof_inside _law{};
	gustproof_sample _now{};
	vehicle_control_mode_s _control_mode{};
	vehicle_land_detected_s _land{};
	control_allocator_status_s _allocated{};
	debug_array_s _array{};

	int _mode{-1};  // as a navigation state; -1 until PX4 has registered it
	int _check{-1}; // number of the arming check that comes with it
	hrt_abstime _asked{0};
	uint64_t _request{0};

	hrt_abstime _last_sample{0};
	hrt_abstime _entered{0};
	float _interval{1.f / GUSTPROOF_RATE}; // [s] of samples, smoothed
	bool _flying{false};
	bool _rate_fits{true};
	unsigned _restarts{0};

	float _thrust[3] {};
	float _before[3] {}; // torque set-point of the mode before, smoothed
	float _hover{0.5f};

	DEFINE_PARAMETERS(
		(ParamInt<px4::params::GP_HOLD>) _param_hold,
		(ParamFloat<px4::params::GP_TRQ_ROLL>) _param_roll_torque,
		(ParamFloat<px4::params::GP_TRQ_PITCH>) _param_pitch_torque,
		(ParamFloat<px4::params::GP_TRQ_YAW>) _param_yaw_torque,
		(ParamFloat<px4::params::MPC_THR_HOVER>) _param_hover
	)
};
