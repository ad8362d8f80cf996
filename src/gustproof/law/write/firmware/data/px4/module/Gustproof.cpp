/* A mode that flies law '$name' in place of PX4's attitude and rate loops; by gustproof $version. */
#include "Gustproof.hpp"

#include <drivers/drv_hrt.h>
#include <mathlib/mathlib.h>
#include <matrix/math.hpp>
#include <px4_platform_common/log.h>

#include <cstring>

using namespace time_literals;

static constexpr char MODE_NAME[] = "$mode";
static constexpr bool TAKES_REFERENCES = $takes_references;
static constexpr hrt_abstime FRESH = 500_ms;
static constexpr float SMOOTHING = 0.2f; // [s] of the torque to begin with: gusts and noise shall not count
// of the law's vehicle, and no parameters' defaults: PX4's build keeps those of the law that was built before
static constexpr float FULL_TORQUE[3] {$roll_torque, $pitch_torque, $yaw_torque};
static constexpr float STANDING = 0.3f; // [m/s] of a set-point that holds a place

Gustproof::Gustproof() :
	ModuleParams(nullptr),
	WorkItem(MODULE_NAME, px4::wq_configurations::rate_ctrl)
{
	check_parameters();
}

bool Gustproof::init()
{
	return _gyro_sub.registerCallback();
}

void Gustproof::check_parameters()
{
	_hover = _param_hover.get();

	if (hold() < Hold::level || hold() > Hold::sticks || (!TAKES_REFERENCES && hold() > Hold::height)) {
		PX4_ERR("GP_HOLD %d: law '%s' holds level", (int)_param_hold.get(), "$name");
		_param_hold.set(static_cast<int32_t>(Hold::height));
	}
}

void Gustproof::Run()
{
	if (should_exit()) {
		_gyro_sub.unregisterCallback();
		unregister_mode();
		exit_and_cleanup();
		return;
	}

	if (_parameter_sub.updated()) {
		parameter_update_s update;
		_parameter_sub.copy(&update);
		updateParams();
		check_parameters();
		configure_mode();
	}

	vehicle_angular_velocity_s gyro;

	if (!_gyro_sub.update(&gyro)) {
		return;
	}

	const float interval = (gyro.timestamp_sample - _last_sample) * 1e-6f;
	_last_sample = gyro.timestamp_sample;
	watch_rate(interval);
	register_mode(gyro.timestamp_sample);
	answer_arming_check();
	read_sensors(gyro, interval);
	follow_torque(interval);
	fly(gyro.timestamp_sample);
}

void Gustproof::watch_rate(float interval)
{
	if (interval > 0.f && interval < 0.1f) {
		_interval += 0.01f * (interval - _interval);
	}

	const bool fits = fabsf(_interval * GUSTPROOF_RATE - 1.f) < 0.1f;

	if (!fits && _rate_fits) {
		PX4_ERR("gyro at %d Hz, law for %d Hz: set IMU_GYRO_RATEMAX, or export with --rate",
			(int)lroundf(1.f / _interval), GUSTPROOF_RATE);
	}

	_rate_fits = fits;
}

void Gustproof::register_mode(hrt_abstime now)
{
	register_ext_component_reply_s reply;

	while (_mode < 0 && _registered_sub.update(&reply)) {
		if (reply.request_id == _request && reply.success) {
			_mode = reply.mode_id;
			_check = reply.arming_check_id;
			configure_mode();
			PX4_INFO("mode '%s' is nav_state %d", MODE_NAME, _mode);
		}
	}

	if (_mode >= 0 || now < _asked + 1_s) {
		return;
	}

	_asked = now;
	_request = now;
	register_ext_component_request_s request{};
	request.timestamp = hrt_absolute_time();
	request.request_id = _request;
	strncpy(request.name, MODE_NAME, sizeof(request.name) - 1);
	request.px4_ros2_api_version = register_ext_component_request_s::LATEST_PX4_ROS2_API_VERSION;
	request.register_arming_check = true;
	request.register_mode = true;
	_register_pub.publish(request);
}

void Gustproof::unregister_mode()
{
	if (_mode < 0) {
		return;
	}

	unregister_ext_component_s request{};
	request.timestamp = hrt_absolute_time();
	strncpy(request.name, MODE_NAME, sizeof(request.name) - 1);
	request.arming_check_id = _check;
	request.mode_id = _mode;
	request.mode_executor_id = -1;
	_unregister_pub.publish(request);
}

void Gustproof::configure_mode()
{
	if (_mode < 0) {
		return;
	}

	// PX4 maps sticks to attitude where it controls attitude; the rates that it then asks for are not flown
	const bool sticks = hold() == Hold::sticks;
	const bool height = hold() == Hold::height || hold() == Hold::position;
	vehicle_control_mode_s mode{};
	mode.source_id = _mode;
	mode.flag_control_manual_enabled = sticks;
	mode.flag_control_attitude_enabled = sticks;
	mode.flag_control_altitude_enabled = height;
	mode.flag_control_climb_rate_enabled = height;
	mode.flag_control_acceleration_enabled = height;
	mode.flag_control_position_enabled = hold() == Hold::position;
	mode.flag_control_velocity_enabled = hold() == Hold::position;
	mode.flag_control_allocation_enabled = true;
	mode.timestamp = hrt_absolute_time();
	_configure_pub.publish(mode);
}

void Gustproof::answer_arming_check()
{
	arming_check_request_s request;

	if (_mode < 0 || !_check_sub.update(&request)) {
		return;
	}

	arming_check_reply_s reply{};
	reply.timestamp = hrt_absolute_time();
	reply.request_id = request.request_id;
	reply.registration_id = _check;
	reply.can_arm_and_run = _rate_fits;
	reply.mode_req_angular_velocity = true;
	reply.mode_req_attitude = true;
	reply.mode_req_local_alt = hold() == Hold::height || hold() == Hold::position;
	reply.mode_req_local_position = hold() == Hold::position;
	reply.mode_req_manual_control = hold() == Hold::sticks;
	_check_pub.publish(reply);
}

bool Gustproof::in_control()
{
	_control_mode_sub.update(&_control_mode);
	return _mode >= 0 && _control_mode.source_id == _mode && !_control_mode.flag_control_rates_enabled;
}

void Gustproof::enter()
{
	const float yaw = matrix::Eulerf(matrix::Quatf(_now.attitude)).psi();
	matrix::Quatf(matrix::Eulerf(0.f, 0.f, yaw)).copyTo(_now.reference);
	_thrust[0] = _thrust[1] = 0.f;
	_thrust[2] = -_hover;
	_entered = hrt_absolute_time();
	_flying = true;

	vehicle_local_position_s position;

	if (!_control_mode.flag_control_altitude_enabled || !_position_sub.copy(&position)) {
		return;
	}

	// where the mode before held a place, that place is kept: another one would tilt the vehicle at once
	const bool fixed = _control_mode.flag_control_position_enabled;
	trajectory_setpoint_s before;
	const bool kept = _trajectory_sub.copy(&before) && _entered < before.timestamp + FRESH
			  && matrix::Vector3f(before.position).isAllFinite()
			  && !(matrix::Vector3f(before.velocity).norm() > STANDING);
	trajectory_setpoint_s here{};
	here.position[0] = fixed ? (kept ? before.position[0] : position.x) : NAN;
	here.position[1] = fixed ? (kept ? before.position[1] : position.y) : NAN;
	here.position[2] = kept ? before.position[2] : position.z;
	here.acceleration[0] = here.acceleration[1] = fixed ? NAN : 0.f;
	here.acceleration[2] = NAN;
	here.yaw = kept && PX4_ISFINITE(before.yaw) ? before.yaw : yaw;
	here.yawspeed = NAN;

	for (int i = 0; i < 3; i++) {
		here.velocity[i] = here.jerk[i] = NAN;
	}

	here.timestamp = hrt_absolute_time();
	_trajectory_pub.publish(here);
}

float Gustproof::full_torque(int axis) const
{
	const float given[3] {_param_roll_torque.get(), _param_pitch_torque.get(), _param_yaw_torque.get()};
	return given[axis] > 0.f ? given[axis] : FULL_TORQUE[axis];
}

void Gustproof::follow_torque(float interval)
{
	vehicle_torque_setpoint_s setpoint;

	if (_flying || !_torque_sub.update(&setpoint)) {
		return;
	}

	const float share = math::constrain(interval / SMOOTHING, 0.f, 1.f);

	for (int i = 0; i < 3; i++) {
		const float change = share * (setpoint.xyz[i] - _before[i]);
		_before[i] = PX4_ISFINITE(change) ? _before[i] + change : 0.f;
	}
}

void Gustproof::take_over()
{
	const float torque[3] {
		_before[0] * full_torque(0),
		_before[1] * full_torque(1),
		_before[2] * full_torque(2),
	};
	gustproof_take_over(&_law, torque);
}

void Gustproof::choose_setpoint(hrt_abstime now)
{
	// one of the mode before goes on only where its source does: PX4's position loops and stick mapping
	vehicle_attitude_setpoint_s setpoint;
	const bool goes_on = _control_mode.flag_multicopter_position_control_enabled || _control_mode.flag_control_manual_enabled;

	if (_attitude_setpoint_sub.copy(&setpoint) && (goes_on || setpoint.timestamp > _entered)
	    && now < setpoint.timestamp + FRESH) {
		memcpy(_now.reference, setpoint.q_d, sizeof(_now.reference));
		memcpy(_thrust, setpoint.thrust_body, sizeof(_thrust));
	}

	// MAVLink's attitude targets reach no mode but OFFBOARD, its arrays do
	_array_sub.update(&_array);

	if (now < _array.timestamp + FRESH && strncmp(_array.name, "gustproof", sizeof(_array.name)) == 0) {
		memcpy(_now.reference, _array.data, sizeof(_now.reference));
		_thrust[0] = _thrust[1] = 0.f;
		_thrust[2] = -_array.data[4];
	}
}

void Gustproof::tell_saturation(hrt_abstime now)
{
	_allocator_sub.update(&_allocated);

	if (!_allocated.torque_setpoint_achieved && now < _allocated.timestamp + 20_ms) {
		const float missing[3] {
			-_allocated.unallocated_torque[0] * full_torque(0),
			-_allocated.unallocated_torque[1] * full_torque(1),
			-_allocated.unallocated_torque[2] * full_torque(2),
		};
		gustproof_undelivered(&_law, missing);
	}
}

void Gustproof::read_sensors(const vehicle_angular_velocity_s &gyro, float interval)
{
	vehicle_attitude_s attitude{};
	vehicle_acceleration_s acceleration{};
	_attitude_sub.copy(&attitude);
	_acceleration_sub.copy(&acceleration);
	_land_sub.update(&_land);

	_now.elapsed = interval;
	memcpy(_now.gyro, gyro.xyz, sizeof(_now.gyro));
	memcpy(_now.force, acceleration.xyz, sizeof(_now.force));
	memcpy(_now.attitude, attitude.q, sizeof(_now.attitude));
	const float age = static_cast<int64_t>(gyro.timestamp_sample - attitude.timestamp_sample) * 1e-6f;
	_now.age = math::constrain(age, 0.f, 0.02f);
}

void Gustproof::fly(hrt_abstime sample)
{
	if (!in_control()) {
		_flying = false;
		return;
	}

	const hrt_abstime now = hrt_absolute_time();

	if (!_flying || !_control_mode.flag_armed) {
		const bool switched = !_flying && _control_mode.flag_armed;
		enter();
		gustproof_start(&_law, &_now);
		_now.elapsed = 1.f / GUSTPROOF_RATE;

		if (switched && !_land.landed) {
			take_over();
		}

	} else if (_land.landed) {
		gustproof_start(&_law, &_now); // or its integrators would wind up against the ground
		_now.elapsed = 1.f / GUSTPROOF_RATE;

	} else {
		tell_saturation(now);
	}

	choose_setpoint(now);
	float torque[3];
	_restarts += gustproof_run(&_law, &_now, torque);
	publish(torque, sample);
}

void Gustproof::publish(const float torque[3], hrt_abstime sample)
{
	vehicle_thrust_setpoint_s thrust_setpoint{};
	memcpy(thrust_setpoint.xyz, _thrust, sizeof(_thrust));
	thrust_setpoint.timestamp_sample = sample;
	thrust_setpoint.timestamp = hrt_absolute_time();
	_thrust_pub.publish(thrust_setpoint);

	vehicle_torque_setpoint_s torque_setpoint{};
	torque_setpoint.xyz[0] = math::constrain(torque[0] / full_torque(0), -1.f, 1.f);
	torque_setpoint.xyz[1] = math::constrain(torque[1] / full_torque(1), -1.f, 1.f);
	torque_setpoint.xyz[2] = math::constrain(torque[2] / full_torque(2), -1.f, 1.f);
	torque_setpoint.timestamp_sample = sample;
	torque_setpoint.timestamp = hrt_absolute_time();
	_torque_pub.publish(torque_setpoint);
}

int Gustproof::print_status()
{
	PX4_INFO("law '%s', %d Hz, gyro at %.1f Hz", "$name", GUSTPROOF_RATE, (double)(1.f / _interval));
	PX4_INFO("mode '%s', nav_state %d: %s, %u restarts", MODE_NAME, _mode, _flying ? "in control" : "not in control",
		 _restarts);
	PX4_INFO("torque set-point 1 is %.4f, %.4f, %.4f N m",
		 (double)full_torque(0), (double)full_torque(1), (double)full_torque(2));
	return 0;
}

int Gustproof::task_spawn(int argc, char *argv[])
{
	Gustproof *instance = new Gustproof();

	if (instance) {
		keep(instance);

		if (instance->init()) {
			return PX4_OK;
		}

	} else {
		PX4_ERR("alloc failed");
	}

	delete instance;
	keep(nullptr);
	return PX4_ERROR;
}

int Gustproof::custom_command(int argc, char *argv[])
{
	return print_usage("unknown command");
}

int Gustproof::print_usage(const char *reason)
{
	if (reason) {
		PX4_WARN("%s", reason);
	}

	PRINT_MODULE_DESCRIPTION("Law '$name' in place of the attitude and rate loops, in the mode '$mode'.");
	PRINT_MODULE_USAGE_NAME("gustproof", "controller");
	PRINT_MODULE_USAGE_COMMAND("start");
	PRINT_MODULE_USAGE_DEFAULT_COMMANDS();
	return 0;
}

extern "C" __EXPORT int gustproof_main(int argc, char *argv[])
{
	return Gustproof::main(argc, argv);
}
