"""Facts of the autopilot families that the controller flies: modes, parameters, streams, and fail-safe in words."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.autopilot.parameters import HOVER_NAME, RATE_NAME


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotFamily:
    """One kind of autopilot, by MAV_AUTOPILOT."""

    name: str
    """Name for people."""
    mode_name: str
    """Name of the mode that takes set-points."""
    modes: frozenset[int]
    """Custom modes in which it obeys set-points."""
    mode: int
    """Custom mode to request for set-points."""
    hold_mode: int
    """Custom mode in which the vehicle is handed back: it stays in place and needs no pilot."""
    takeover_modes: frozenset[int]
    """Custom modes of open-ended flight by a pilot; take-off, landing and return are not interrupted."""
    parameters: tuple[str, ...]
    """Parameters to read: the first is the hover thrust."""
    samples: tuple[int, ...]
    """Messages that carry samples, the best first."""
    fail_safe: tuple[str, ...]
    """Parameters of its fail-safe when set-points stop."""
    estimator: str = ""
    """Parameter that is set if an estimator has taken all but the turn of the earth from the samples' rates."""
    takes_torques: bool = True
    """True if there are autopilots of this family that take torques."""
    streams_on_standby: bool = False
    """True if it enters the mode only while set-points arrive, and obeys them in no other."""
    mode_takes_off: bool = False
    """True if the mode that takes set-points also takes off by itself, so that it is flown in the air alone."""
    bytewise: bool = True
    """True if integer parameters travel bytewise in a float field; they are cast otherwise."""


THRUST_OPTION = "GUID_OPTIONS"
"""Parameter of ArduPilot; with bit 3 thrust is a thrust, without it a climb rate about .5."""
_THRUST_BIT = 8
_PX4_PILOTED = (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.HOLD, Mode.STABILIZED)
_PX4 = AutopilotFamily(
    name="PX4",
    mode_name="OFFBOARD",
    modes=frozenset({Mode.OFFBOARD.value}),
    mode=Mode.OFFBOARD.value,
    hold_mode=Mode.HOLD.value,
    takeover_modes=frozenset(mode.value for mode in _PX4_PILOTED),
    parameters=(HOVER_NAME, RATE_NAME),
    samples=(wire.MAVLINK_MSG_ID_HIGHRES_IMU,),
    fail_safe=("COM_OF_LOSS_T", "COM_OBL_RC_ACT"),
    estimator="EKF2_EN",
    streams_on_standby=True,
)
_GENERIC = replace(_PX4, name="a generic autopilot", streams_on_standby=False)
_ARDUPILOT = AutopilotFamily(
    name="ArduPilot",
    mode_name="GUIDED",
    modes=frozenset({4, 20}),  # GUIDED, GUIDED_NOGPS
    mode=4,
    hold_mode=17,  # BRAKE
    takeover_modes=frozenset({0, 1, 2, 5, 13, 16, 17}),  # STABILIZE ACRO ALT_HOLD LOITER SPORT POSHOLD BRAKE
    parameters=("MOT_THST_HOVER", THRUST_OPTION),
    samples=(wire.MAVLINK_MSG_ID_HIGHRES_IMU, wire.MAVLINK_MSG_ID_RAW_IMU, wire.MAVLINK_MSG_ID_SCALED_IMU),
    fail_safe=("GUID_TIMEOUT",),
    takes_torques=False,
    mode_takes_off=True,
    bytewise=False,
)
FAMILIES = {
    wire.MAV_AUTOPILOT_PX4: _PX4,
    wire.MAV_AUTOPILOT_GENERIC: _GENERIC,
    wire.MAV_AUTOPILOT_ARDUPILOTMEGA: _ARDUPILOT,
}
"""Supported families by MAV_AUTOPILOT."""
_PX4_ACTIONS = ("Position", "Altitude", "Stabilized", "Return", "Land", "Hold", "Terminate", "Disarm")


def mode_parameters(mode: int) -> tuple[float, float]:
    """Return second and third parameter of MAV_CMD_DO_SET_MODE for a custom mode; PX4's has two parts."""
    return (mode, 0.0) if mode < 1 << 16 else (mode >> 16 & 255, mode >> 24)


def takes_thrust(parameters: Mapping[str, float | None]) -> bool:
    """Return whether the thrust of a set-point is a thrust; to ArduPilot it may be a climb rate."""
    options = parameters.get(THRUST_OPTION)
    return options is None or bool(int(options) & _THRUST_BIT)


def describe_fail_safe(family: AutopilotFamily, values: Mapping[str, float]) -> str:
    """Return the autopilot's own action when set-points stop, in words, from all parameters of its fail-safe."""
    timeout_s, *action = (values[name] for name in family.fail_safe)
    then = "levels and holds its height"
    if action:
        number = int(action[0])
        mode = _PX4_ACTIONS[number] if 0 <= number < len(_PX4_ACTIONS) else "unknown"
        then = f"enters its fail-safe: {mode} ({family.fail_safe[1]} {number})"
    return f"if set-points stop, {family.name} {then} after {timeout_s:g} s ({family.fail_safe[0]})"
