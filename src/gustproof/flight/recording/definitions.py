"""Our own ROS messages, for data without a standard type; their comments state units and frames.

A bag carries these texts: readers need nothing else to decode and understand the messages.
"""

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from firmware_model.autopilot.modes import Mode
from firmware_model.config.vehicle import MOST_ROTORS

FLIGHT, MODE, COMMAND_AGE, ANGLES, REQUIREMENT = (
    f"gustproof_msgs/msg/{name}" for name in ("Flight", "Mode", "CommandAge", "Angles", "Requirement")
)
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
"""Standard type of frames: 3D views of Foxglove and RViz place things by it."""
LOG = "rcl_interfaces/msg/Log"
"""Standard type of a log line: viewers list it with its time."""
_PLACES = {4: ": front right, rear left, front left, rear right"}


def rotors_message(rotors: int) -> str:
    """Return the type of the thrusts of a vehicle with `rotors`: `Rotors` for four, `Rotors6` for six."""
    return f"gustproof_msgs/msg/Rotors{rotors if rotors != 4 else ''}"


_OWN_MESSAGES = {
    FLIGHT: """# Metadata of the flight, once, at its first sample: all that is needed to repeat it.

# JSON: scenario, vehicle, law with its matrices, seed, real time or not, versions, outcome.
# Units: named by the keys (_s, _m, _mps, _deg, _nm, _us), otherwise SI and radians.
# Frames: _N is north-east-down, _B is forward-right-down.
string document
""",
    MODE: """# Mode of the autopilot, at the first sample and at each change.

# stamp: model time from the flight's first commanded sample. frame_id: the body, forward-right-down.
std_msgs/Header header

# PX4's custom_mode: main mode in bits 16 to 23, sub-mode in bits 24 to 31.
uint32 custom_mode

"""
    + "".join(f"uint32 {mode.name}={mode.value}\n" for mode in Mode),
    **{
        rotors_message(n): f"""# Thrust of each rotor, with the lag of the motors.

# stamp: model time from the flight's first commanded sample. frame_id: the body, forward-right-down.
std_msgs/Header header

# [N] thrust against the z axis, up{_PLACES.get(n, ", in the order of the vehicle file")}.
float64[{n}] thrust
"""
        for n in range(4, MOST_ROTORS + 1)
    },
    COMMAND_AGE: """# Age of the command in effect: delay by link, controller and vehicle.

# stamp: model time from the flight's first commanded sample. frame_id: the body, forward-right-down.
std_msgs/Header header

# [samples] whole, from the sample of the command's timestamp to this one: the scenario's delay_samples if the command
# came in time. NaN without a command in effect: on-board loops fly, or none has come.
float64 age
""",
    ANGLES: """# Euler angles, ZYX: attitude, its reference, or attitude less reference.

# stamp: model time from the flight's first commanded sample. frame_id: north-east-down.
std_msgs/Header header

# [deg]
float64 roll
float64 pitch
float64 yaw
""",
    REQUIREMENT: """# A requirement of the scenario, at the end of its window, or of a flight that broke off before.

# stamp: model time from the flight's first commanded sample. frame_id: the body, forward-right-down.
std_msgs/Header header

# The metric with its unit, such as peak_deg, and its axis: roll, pitch, yaw, or empty for all.
string metric
string axis

# [s] window
float64 from_s
float64 to_s

# [unit of the metric] limits and flown value; NaN if there is none.
float64 at_least
float64 at_most
float64 value

# False for a window that was not flown to its end; then held is false too.
bool judged
bool held
""",
}

STANDARD_MESSAGES = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/msg/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/msg/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/msg/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    **{
        f"geometry_msgs/msg/{name}Stamped": f"std_msgs/Header header\ngeometry_msgs/{name} {name.lower().rstrip('3')}"
        for name in ("Pose", "Quaternion", "Twist", "Vector3", "Wrench")
    },
    "sensor_msgs/msg/Imu": """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
""",
    "geometry_msgs/msg/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/msg/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    TF_MESSAGE: "geometry_msgs/TransformStamped[] transforms",
    LOG: """uint8 DEBUG=10
uint8 INFO=20
uint8 WARN=30
uint8 ERROR=40
uint8 FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
""",
}
"""Types of ROS 2 Jazzy that we use; to import all that it has takes a tenth of a second of each start."""

TYPES = get_typestore(Stores.EMPTY)
"""The standard types and ours."""
_parsed = [get_types_from_msg(text, name) for name, text in (STANDARD_MESSAGES | _OWN_MESSAGES).items()]
TYPES.register({name: fields for each in _parsed for name, fields in each.items()})


def definition(message: str) -> tuple[str, str]:
    """Return the definition of a type for a bag, ours with comments, and its hash."""
    text, _ = TYPES.generate_msgdef(message, ros_version=2)
    if message in _OWN_MESSAGES:
        _, rule, others = text.partition("=" * 80)
        text = _OWN_MESSAGES[message] + rule + others
    return text, TYPES.hash_rihs01(message)
