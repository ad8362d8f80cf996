"""Our own ROS messages, for what no standard type says; units and frames stand in their comments.

A bag carries these texts, so that readers need nothing else to decode the messages, or to know what they mean.
"""

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from firmware_model.autopilot.modes import Mode

FLIGHT, MODE, ROTORS, COMMAND_AGE = (
    f"gustproof_msgs/msg/{name}" for name in ("Flight", "Mode", "Rotors", "CommandAge")
)

_OWN_MESSAGES = {
    FLIGHT: """# What was flown, once, at the flight's first sample: all that is needed to fly it again.

# JSON: scenario, vehicle, law with its matrices, seed, whether in real time, versions; and how it ended.
# Units: those of its keys (_s, _m, _mps, _deg, _nm, _us), SI and radians where a key names none.
# Frames: _N is north-east-down, _B is forward-right-down.
string document
""",
    MODE: """# The autopilot's mode, at the first sample and whenever it changes.

# stamp: model time from the flight's first commanded sample. frame_id: the body, forward-right-down.
std_msgs/Header header

# PX4's custom_mode: main mode in bits 16 to 23, sub-mode in bits 24 to 31.
uint32 custom_mode

"""
    + "".join(f"uint32 {mode.name}={mode.value}\n" for mode in Mode),
    ROTORS: """# What each rotor gives, the lag of the motors included.

# stamp: model time from the flight's first commanded sample. frame_id: the body, forward-right-down.
std_msgs/Header header

# [N] thrust against the z axis, up: front right, rear left, front left, rear right.
float64[4] thrust
""",
    COMMAND_AGE: """# How old the command is that acts: what the link, the controller and the vehicle's own delay take.

# stamp: model time from the flight's first commanded sample. frame_id: the body, forward-right-down.
std_msgs/Header header

# [samples] whole, from the sample that the command answers by its stamp to this one: the scenario's delay_samples if it
# came in time. NaN while no command acts: on-board loops fly, or none has come.
float64 age
""",
}

TYPES = get_typestore(Stores.ROS2_JAZZY)
"""The standard types, and ours."""
for _name, _text in _OWN_MESSAGES.items():
    TYPES.register(get_types_from_msg(_text, _name))


def definition(message: str) -> tuple[str, str]:
    """Return the definition of a type as a bag carries it, ours with its comments, and its hash."""
    text, _ = TYPES.generate_msgdef(message, ros_version=2)
    if message in _OWN_MESSAGES:
        _, rule, others = text.partition("=" * 80)
        text = _OWN_MESSAGES[message] + rule + others
    return text, TYPES.hash_rihs01(message)
