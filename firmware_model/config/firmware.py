"""Parameters by which PX4 and ArduPilot know a vehicle, and the torque that their full commands then mean.

PX4 divides each column of its mixer by a scale of its own, ArduPilot has fixed factors for each frame. So a normalised
torque of 1.0 is not the vehicle's `torque_limit`. Motors are linear: thrust is a fraction of `thrust_max`.
"""

import numpy as np

from firmware_model.config.vehicle import GRAVITY, ON_BOARD, FullScale, Rotors, Vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import AXES, Vector

Parameters = dict[str, str]
_SPIN_RANGE = (0.15, 0.95)  # ArduPilot's MOT_SPIN_MIN and MOT_SPIN_MAX by default: motor commands of thrust 0 and 1
_X_SIDES = ((1, 1), (-1, -1), (1, -1), (-1, 1))  # forward, right
_X_SPIN = (1, 1, -1, -1)
_EVEN = 0.05  # [rad] of directions of rotors that are the same, or evenly spaced
_SAME_TORQUE = 0.1  # [-] relative difference of torques within which rotors are those of a log
LAW_GYRO_FILTER_HZ = 80.0
"""[Hz] corner of the gyro's low-pass about a law inside an autopilot: the usual one costs margins."""


def hover_fraction(vehicle: Vehicle) -> float:
    """Return the thrust of hover as a fraction of the largest."""
    return vehicle.mass * GRAVITY / vehicle.rotors.total_thrust


def px4_parameters(vehicle: Vehicle) -> Parameters:
    """Return PX4's parameters for the geometry and the motors of a vehicle, whose thrust is linear in the command.

    Raises
    ------
    ConfigError
        If it has more than four rotors.
    """
    rotors = vehicle.rotors
    if rotors.count != 4:
        raise ConfigError(f"vehicle '{vehicle.name}': PX4 flies four rotors here, not {rotors.count}")
    values = {"CA_AIRFRAME": "0", "CA_ROTOR_COUNT": "4", "THR_MDL_FAC": "0"}
    for i, ((x, y, z), spin) in enumerate(zip(rotors.position_B, rotors.spin, strict=True)):
        place = {"PX": x, "PY": y, "PZ": z, "KM": spin * rotors.drag_ratio}
        values |= {f"CA_ROTOR{i}_{name}": f"{value:.7g}" for name, value in place.items()}
    values["MC_YAW_TQ_CUTOFF"] = "0"  # its filter against the noise of propellers, in the loop: yaw would oscillate
    values["MPC_THR_HOVER"] = f"{hover_fraction(vehicle):.7g}"
    return values


def px4_full_torque(rotors: Rotors) -> Vector:
    """Return the torque [N*m] B of PX4's torque set-point 1.0 about each axis, with `px4_parameters`.

    Roll and pitch have one scale, the larger rms of their mixer columns times sqrt 2; yaw has the largest entry.
    """
    columns = rotors.allocation[:, :3]
    tilt = np.max(np.linalg.norm(columns[:, :2], axis=0)) / 2.0**0.5
    return _full_torque(rotors, columns / (tilt, tilt, np.max(columns[:, 2])))


def ardupilot_parameters(vehicle: Vehicle) -> Parameters:
    """Return ArduPilot's parameters of frame and motors.

    Raises
    ------
    ConfigError
        If the rotors are no quadrotor X in PX4's order, which is ArduPilot's too.
    """
    _check_x(vehicle)
    low, high = _SPIN_RANGE
    return {
        "FRAME_CLASS": "1",
        "FRAME_TYPE": "1",
        "MOT_THST_EXPO": "0",
        "MOT_SPIN_MIN": f"{low}",
        "MOT_SPIN_MAX": f"{high}",
        "MOT_THST_HOVER": ardupilot_hover(vehicle, _SPIN_RANGE),
    }


def ardupilot_hover(vehicle: Vehicle, thrust_range: tuple[float, float]) -> str:
    """Return ArduPilot's throttle of hover, whose 0 and 1 are the thrusts of a range, as fractions of the largest."""
    low, high = thrust_range
    return f"{(hover_fraction(vehicle) - low) / (high - low):.7g}"


def ardupilot_full_torque(vehicle: Vehicle) -> Vector:
    """Return the torque [N*m] B of ArduPilot's motor input 1.0 about each axis, if motors span thrust 0 to 1.

    With MOT_SPIN_MIN and MOT_SPIN_MAX it is their difference times that.

    A rotor's share in roll and pitch goes by its direction alone, scaled so that the largest is one half. So is its
    share in yaw. Frames are X and plus of four to twelve rotors, one or two on an arm, and Y6.

    Raises
    ------
    ConfigError
        If the rotors are no such frame.
    """
    rotors = vehicle.rotors
    angles = np.array([np.arctan2(y, x) for x, y, _ in rotors.position_B])
    sides = [(int(np.sign(x)), int(np.sign(y))) for x, y, _ in rotors.position_B]
    if sorted(sides) == sorted(_X_SIDES):  # a quadrotor X, whatever its angles
        angles = np.array([np.arctan2(right, forward) for forward, right in sides])
    shares = np.column_stack([-np.sin(angles), np.cos(angles), rotors.spin])
    coupled = shares.T @ shares
    if not _is_even(angles) or not np.allclose(coupled, np.diag(np.diag(coupled)), atol=_EVEN) or np.sum(rotors.spin):
        raise ConfigError(
            f"vehicle '{vehicle.name}': rotors must be evenly around it, one or two on an arm, half of them turning "
            "each way, as ArduPilot's frames are"
        )
    return _full_torque(rotors, 0.5 * shares / np.max(np.abs(shares), axis=0))


def measured_torque(autopilot: str, vehicle: Vehicle) -> Vector | None:
    """Return the torque [N*m] B of the command 1.0 of `px4` or `ardupilot` as a log states it, else `None`.

    ArduPilot's is that at the range of thrust that its motors spanned in the log.

    Raises
    ------
    ConfigError
        If neither a log nor the rotors tell it, or a log of another autopilot does.
    """
    command = vehicle.command
    if command is None or command.full_scale is FullScale.ROTORS:
        return None
    if command.full_scale is FullScale.UNKNOWN:
        raise ConfigError(
            f"vehicle '{vehicle.name}': what a command of 1.0 of {autopilot} gives is unknown: its log has no such "
            "command, and its rotors are assumed. Identify it from a log of that autopilot, or with --like"
        )
    if command.autopilot in ON_BOARD and command.autopilot != autopilot:
        raise ConfigError(
            f"vehicle '{vehicle.name}': a log of {command.autopilot} measured what its command of 1.0 gives, which is "
            f"not that of {autopilot}"
        )
    return vehicle.torque_limit


def is_measured(vehicle: Vehicle) -> bool:
    """Return whether a log, not the rotors, tells what a command of 1.0 gives: then its rotors are assumed."""
    return vehicle.command is not None and vehicle.command.full_scale is FullScale.MEASURED


def guessed_axes(vehicle: Vehicle) -> tuple[int, ...]:
    """Return the axes about which the torque is a guess: the vehicle's log measured that of others alone."""
    unmeasured = vehicle.command.unmeasured if is_measured(vehicle) and vehicle.command else ()
    return tuple(AXES.index(axis) for axis in unmeasured)


def check_measured(vehicle: Vehicle) -> None:
    """Refuse a vehicle whose torque in yaw is a guess; roll and pitch have each other's measure.

    Raises
    ------
    ConfigError
        If its log did not excite yaw.
    """
    if AXES.index("yaw") in guessed_axes(vehicle):
        raise ConfigError(
            f"vehicle '{vehicle.name}': its log did not excite yaw, so what a command of yaw gives is a guess: fly "
            "steps of yaw, and identify it again"
        )


def check_rotors(vehicle: Vehicle) -> None:
    """Refuse a vehicle that its rotors do not fly as its log measured: a simulated autopilot flies the rotors.

    Raises
    ------
    ConfigError
        If the torque of a command of 1.0 by the rotors is not the measured one.
    """
    command = vehicle.command
    if command is None or command.full_scale is FullScale.ROTORS:
        return
    by_rotors: Vector | None = None
    if is_measured(vehicle) and command.autopilot == "px4":
        by_rotors = px4_full_torque(vehicle.rotors)
    elif is_measured(vehicle) and command.autopilot == "ardupilot":
        roll, pitch, yaw = ardupilot_full_torque(vehicle)
        by_rotors = command.thrust_range * roll, command.thrust_range * pitch, command.thrust_range * yaw
    if by_rotors is None or not np.allclose(by_rotors, vehicle.torque_limit, rtol=_SAME_TORQUE):
        raise ConfigError(
            f"vehicle '{vehicle.name}': its rotors are assumed, and do not give the torque that its log measured: an "
            "autopilot in simulation would fly another vehicle. Give [rotors] that do, and leave out [command]"
        )


def _is_even(angles: np.ndarray[tuple[int], np.dtype[np.float64]]) -> bool:
    """Return whether directions [rad] are evenly spaced, with as many rotors, one or two, in each."""
    turned = np.sort((angles - angles[0] + 2.0 * _EVEN) % (2.0 * np.pi))
    for pair in (1, 2):
        arms = turned.reshape(-1, pair) if len(angles) % pair == 0 else np.empty((0, pair))
        gaps = np.diff(arms.mean(axis=1), append=arms.mean(axis=1)[:1] + 2.0 * np.pi)
        if len(arms) > 2 and np.allclose(arms, arms[:, :1], atol=_EVEN) and np.allclose(gaps, gaps.mean(), atol=_EVEN):
            return True
    return False


def _full_torque(rotors: Rotors, mixer: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Vector:
    """Return the torque [N*m] of 1.0 about each axis by a mixer (n, 3) of fractions of a rotor's largest thrust."""
    roll, pitch, yaw = np.diag(rotors.wrench[:3] @ mixer * rotors.thrust_max).tolist()
    return roll, pitch, yaw


def _check_x(vehicle: Vehicle) -> None:
    sides = tuple((int(np.sign(x)), int(np.sign(y))) for x, y, _ in vehicle.rotors.position_B)
    if (sides, vehicle.rotors.spin) != (_X_SIDES, _X_SPIN):
        raise ConfigError(
            f"vehicle '{vehicle.name}': rotors must be front right, rear left (spin 1), front left, rear right "
            "(spin -1), ArduPilot's quadrotor X"
        )
