// Declarations of what the generated module uses of PX4: names and types alone, nothing of its code.
#pragma once

#include <cmath>
#include <cstdint>

#define __EXPORT
#define PX4_ISFINITE(x) std::isfinite(x)
#define MODULE_NAME "gustproof"
#define PX4_INFO(...) stub_print(__VA_ARGS__)
#define PX4_WARN(...) stub_print(__VA_ARGS__)
#define PX4_ERR(...) stub_print(__VA_ARGS__)
#define PRINT_MODULE_DESCRIPTION(text) stub_print(text)
#define PRINT_MODULE_USAGE_NAME(name, category) stub_print("%s%s", name, category)
#define PRINT_MODULE_USAGE_COMMAND(name) stub_print(name)
#define PRINT_MODULE_USAGE_DEFAULT_COMMANDS() stub_print("commands")
#define DEFINE_PARAMETERS(...) STUB_EACH(__VA_ARGS__)
#define STUB_EACH(a, b, c, d, e) STUB_ONE a; STUB_ONE b; STUB_ONE c; STUB_ONE d; STUB_ONE e;
#define STUB_ONE(...) __VA_ARGS__
#define ORB_ID(name) static_cast<name##_tag *>(nullptr)

enum { PX4_OK = 0, PX4_ERROR = -1 };
typedef uint64_t hrt_abstime;
hrt_abstime hrt_absolute_time();
void stub_print(const char *format, ...) __attribute__((format(printf, 1, 2)));

namespace time_literals
{
constexpr hrt_abstime operator""_s(unsigned long long value) { return value * 1000000; }
constexpr hrt_abstime operator""_ms(unsigned long long value) { return value * 1000; }
}

struct vehicle_angular_velocity_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };
struct vehicle_acceleration_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };
struct vehicle_attitude_s { uint64_t timestamp, timestamp_sample; float q[4]; };
struct vehicle_attitude_setpoint_s { uint64_t timestamp; float q_d[4], thrust_body[3]; };
struct vehicle_torque_setpoint_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };
struct vehicle_thrust_setpoint_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };
struct vehicle_land_detected_s { uint64_t timestamp; bool landed; };
struct vehicle_local_position_s { uint64_t timestamp; float x, y, z; };
struct trajectory_setpoint_s { uint64_t timestamp; float position[3], velocity[3], acceleration[3], jerk[3], yaw, yawspeed; };
struct debug_array_s { uint64_t timestamp; uint16_t id; char name[10]; float data[58]; };
struct parameter_update_s { uint64_t timestamp; };
struct arming_check_request_s { uint64_t timestamp; uint8_t request_id; };
struct control_allocator_status_s { uint64_t timestamp; bool torque_setpoint_achieved; float unallocated_torque[3]; };
struct vehicle_control_mode_s {
	uint64_t timestamp;
	bool flag_armed, flag_multicopter_position_control_enabled, flag_control_manual_enabled, flag_control_position_enabled,
	     flag_control_velocity_enabled, flag_control_altitude_enabled, flag_control_climb_rate_enabled,
	     flag_control_acceleration_enabled, flag_control_attitude_enabled, flag_control_rates_enabled,
	     flag_control_allocation_enabled;
	uint8_t source_id;
};
struct arming_check_reply_s {
	uint64_t timestamp;
	uint8_t request_id, registration_id;
	bool can_arm_and_run, mode_req_angular_velocity, mode_req_attitude, mode_req_local_alt, mode_req_local_position,
	     mode_req_manual_control;
};
struct register_ext_component_request_s {
	static constexpr uint16_t LATEST_PX4_ROS2_API_VERSION = 1;
	uint64_t timestamp, request_id;
	char name[25];
	uint16_t px4_ros2_api_version;
	bool register_arming_check, register_mode;
};
struct register_ext_component_reply_s { uint64_t request_id; bool success; int8_t arming_check_id, mode_id; };
struct unregister_ext_component_s { uint64_t timestamp; char name[25]; int8_t arming_check_id, mode_id, mode_executor_id; };

struct vehicle_angular_velocity_tag {}; struct vehicle_acceleration_tag {}; struct vehicle_attitude_tag {};
struct vehicle_attitude_setpoint_tag {}; struct vehicle_torque_setpoint_tag {}; struct vehicle_thrust_setpoint_tag {};
struct vehicle_land_detected_tag {}; struct vehicle_local_position_tag {}; struct trajectory_setpoint_tag {};
struct debug_array_tag {}; struct parameter_update_tag {}; struct arming_check_request_tag {};
struct arming_check_reply_tag {}; struct control_allocator_status_tag {}; struct vehicle_control_mode_tag {};
struct config_control_setpoints_tag {}; struct register_ext_component_request_tag {};
struct register_ext_component_reply_tag {}; struct unregister_ext_component_tag {};

namespace px4
{
struct wq_config_t {};
namespace wq_configurations { static const wq_config_t rate_ctrl; }
class WorkItem
{
protected:
	WorkItem(const char *, const wq_config_t &) {}
	virtual ~WorkItem() = default;
	virtual void Run() = 0;
};
enum class params { GP_HOLD, GP_TRQ_ROLL, GP_TRQ_PITCH, GP_TRQ_YAW, MPC_THR_HOVER };
}

template<px4::params> struct ParamInt { int32_t get() const; void set(int32_t); };
template<px4::params> struct ParamFloat { float get() const; };

class ModuleParams
{
protected:
	explicit ModuleParams(ModuleParams *) {}
	virtual ~ModuleParams() = default;
	void updateParams();
};

template<class T> struct stub_object { void store(T *); };

#ifdef PX4_OF_2026
class ModuleBase
{
public:
	struct Descriptor {
		Descriptor(int (*)(int, char **), int (*)(int, char **), int (*)(const char *));
		stub_object<ModuleBase> object;
		int task_id;
	};
	virtual ~ModuleBase() = default;
	virtual int print_status() { return 0; }
	static int main(Descriptor &, int, char **);
	static void exit_and_cleanup(Descriptor &);
	bool should_exit() const;
	static constexpr int task_id_is_work_queue = -2;
};
#else
template<class T> class ModuleBase
{
public:
	virtual ~ModuleBase() = default;
	virtual int print_status() { return 0; }
	static int main(int, char **);
protected:
	static bool should_exit();
	static void exit_and_cleanup();
	static stub_object<T> _object;
	static int _task_id;
	static constexpr int task_id_is_work_queue = -2;
};
#endif

namespace uORB
{
struct Subscription {
	template<class Tag> Subscription(Tag *) {}
	bool updated();
	template<class T> bool update(T *);
	template<class T> bool copy(T *);
};
struct SubscriptionInterval : Subscription {
	template<class Tag> SubscriptionInterval(Tag *tag, uint32_t) : Subscription(tag) {}
};
struct SubscriptionCallbackWorkItem : Subscription {
	template<class Tag> SubscriptionCallbackWorkItem(px4::WorkItem *, Tag *tag) : Subscription(tag) {}
	bool registerCallback();
	void unregisterCallback();
};
template<class T> struct Publication {
	template<class Tag> Publication(Tag *) {}
	bool publish(const T &);
};
}

namespace math { template<class T> T constrain(T, T, T); }

namespace matrix
{
struct Quatf;
struct Vector3f { explicit Vector3f(const float *); bool isAllFinite() const; float norm() const; };
struct Eulerf { Eulerf(float, float, float); Eulerf(const Quatf &); float psi() const; };
struct Quatf { explicit Quatf(const float *); Quatf(const Eulerf &); void copyTo(float *) const; };
}
