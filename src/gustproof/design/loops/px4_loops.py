"""PX4's attitude and rate loops of a multicopter.

    gyro > notches > low-pass = omega;    angular acceleration = low-pass of the slope of omega
    omega_sp = P (attitude set-point - attitude), within the rate limits
    torque = K (P (omega_sp - omega) + I sum - D acceleration) + FF omega_sp;    yaw torque > low-pass

A sample's rate loop runs before its estimator: its attitude, and so its `omega_sp`, is that of the previous sample.

References
----------
PX4, modules mc_att_control, mc_rate_control, sensors/vehicle_angular_velocity and library rate_control, main of
February 2025: order of filters and loops, defaults. The angle loop is of D. Brescianini, M. Hehn, R. D'Andrea,
Nonlinear Quadrocopter Attitude Control, 2013; at small angles its error is the difference of Euler angles.
"""

import math
from collections.abc import Mapping

from firmware_model.config.firmware import measured_torque, px4_full_torque
from firmware_model.config.gyro_filters import PX4_BY_ROTORS, gyro_filters
from firmware_model.config.scenario import sample_time
from firmware_model.config.vehicle import Vehicle
from firmware_model.external.versions import later_defaults
from firmware_model.types import Vector
from gustproof.design.loops.filters import SampledAxisLoop, smoothing
from gustproof.design.loops.settings import FLOWN, AutopilotLoops, LoopSignals, Setting

_NAMES, _LIMITS = ("ROLL", "PITCH", "YAW"), ("MC_RR_INT_LIM", "MC_PR_INT_LIM", "MC_YR_INT_LIM")
_LEAST = 1e-4  # of an angle gain or yaw weight: below it PX4 holds no attitude
_VTOL = (2.0, 3.0, 4.0)  # CA_AIRFRAME of standard VTOL, tiltrotor and tailsitter
_CLASSES = {  # control_allocator's module.yaml of 1.17
    1.0: "plane",
    **dict.fromkeys((5.0, 6.0, 13.0), "rover"),
    7.0: "vehicle whose motors push in all directions",
    **dict.fromkeys((10.0, 11.0, 12.0), "helicopter"),
    **dict.fromkeys((14.0, 15.0), "spacecraft"),
}
_TYPES = {1.0: "plane", 4.0: "helicopter", 7.0: "airship", 10.0: "rover", 11.0: "boat", 12.0: "submarine"}  # MAV_TYPE
_GAINS = r"MC_(ROLL|PITCH|YAW)(_P|RATE_[PIDK])"
_DYNAMIC = 3  # bits of IMU_GYRO_DNF_EN: notches that follow the speed of rotors, or a spectrum


def _settings() -> dict[str, Setting]:
    found = {}
    for axis, angle, (p, i, d), most in (
        ("ROLL", 6.5, (0.15, 0.2, 0.003), 220.0),
        ("PITCH", 6.5, (0.15, 0.2, 0.003), 220.0),
        ("YAW", 2.8, (0.2, 0.1, 0.0), 200.0),
    ):
        found[f"MC_{axis}_P"] = Setting(angle, _LEAST, 100.0)
        found[f"MC_{axis}RATE_P"], found[f"MC_{axis}RATE_I"] = Setting(p, 0.0, 100.0), Setting(i, 0.0, 1000.0)
        found[f"MC_{axis}RATE_D"], found[f"MC_{axis}RATE_K"] = Setting(d, 0.0, 10.0), Setting(1.0, 0.0, 100.0)
        found[f"MC_{axis}RATE_FF"], found[f"MC_{axis}RATE_MAX"] = Setting(0.0, 0.0, 100.0), Setting(most, 1.0, 1800.0)
    found["MC_YAW_WEIGHT"] = Setting(0.4, _LEAST, 1.0)
    # PX4's own is 2, with which the yaw loop of a sound vehicle may oscillate: `fly --autopilot` sets 0.
    found["MC_YAW_TQ_CUTOFF"] = Setting(0.0, 0.0, 1000.0)
    found["IMU_GYRO_CUTOFF"], found["IMU_DGYRO_CUTOFF"] = Setting(40.0, 0.0, 1000.0), Setting(30.0, 0.0, 1000.0)
    for name in ("IMU_GYRO_NF0", "IMU_GYRO_NF1"):
        found[f"{name}_FRQ"], found[f"{name}_BW"] = Setting(0.0, 0.0, 1000.0), Setting(20.0, 0.0, 100.0)
    return found


# mc_rate_control_params.c, mc_att_control_params.c and imu_gyro_parameters.c of 1.15: @min and @max
_DOCUMENTED: dict[str, tuple[float | None, float | None]] = {
    "MC_ROLL_P": (None, 12.0),
    "MC_PITCH_P": (None, 12.0),
    "MC_YAW_P": (None, 5.0),
    "MC_ROLLRATE_P": (0.01, 0.5),
    "MC_PITCHRATE_P": (0.01, 0.6),
    "MC_YAWRATE_P": (None, 0.6),
    "MC_ROLLRATE_D": (None, 0.01),
    "MC_ROLLRATE_K": (0.01, 5.0),
    "MC_PITCHRATE_K": (0.01, 5.0),
    "MC_YAWRATE_K": (None, 5.0),
    "IMU_GYRO_CUTOFF": (None, 1000.0),
    "IMU_DGYRO_CUTOFF": (None, 1000.0),
}


def _full_torque(vehicle: Vehicle, _: Mapping[str, float]) -> Vector:
    return measured_torque("px4", vehicle) or px4_full_torque(vehicle.rotors)


def _build(axis: int, parameters: Mapping[str, float], full_torque: float, rate_hz: int) -> LoopSignals:
    name, dt = _NAMES[axis], sample_time(rate_hz)
    P, I, D, K, FF = (parameters[f"MC_{name}RATE_{gain}"] for gain in ("P", "I", "D", "K", "FF"))  # noqa: E741
    loop = SampledAxisLoop(dt)
    omega = loop.rate
    for each in gyro_filters("px4", parameters, rate_hz):
        omega = loop.apply_filter(omega, each)
    commanded = parameters[f"MC_{name}_P"] * (loop.reference - loop.attitude)
    error = commanded - omega
    integral = loop.state()
    torque = full_torque * (K * (P * error + I * integral) + FF * commanded)
    if D > 0.0:
        cutoff = parameters["IMU_DGYRO_CUTOFF"]
        slope = (omega - loop.delay(omega)) / dt
        torque -= (
            full_torque * K * D * loop.smooth(slope, smoothing(cutoff, rate_hz) if cutoff < 0.5 * rate_hz else 1.0)
        )
    # Back-calculation, so that the integral empties with the time constant of the PI, as in `gustproof.law.cascade`.
    loop.set_next(integral, integral + dt * error, dt / (full_torque * K * P) if K * P > 0.0 else 0.0)
    if name == "YAW":
        torque = loop.smooth(torque, smoothing(parameters["MC_YAW_TQ_CUTOFF"], rate_hz))
    return LoopSignals(loop, torque, commanded, math.radians(parameters[f"MC_{name}RATE_MAX"]))


def _rotors(given: Mapping[str, float]) -> tuple[str, int] | None:
    count = int(given.get("CA_ROTOR_COUNT", 0))
    return (f"CA_ROTOR_COUNT {count}", count) if count else None


def _describe_moving(given: Mapping[str, float]) -> list[str]:
    """Return remarks on notches that move."""
    moving, flown = int(given.get("IMU_GYRO_DNF_EN", 0)) & _DYNAMIC, given.get("IMU_GYRO_DNF" + FLOWN, 0.0)
    found = []
    if moving & PX4_BY_ROTORS and flown:
        found.append(f"IMU_GYRO_DNF_EN: notches at {flown:.0f} Hz, the rotors' median in the log, where PX4 moves them")
        moving -= PX4_BY_ROTORS
    return [*found, "IMU_GYRO_DNF_EN: moving notches are left out"] if moving else found


def _remarks(given: Mapping[str, float], rate_hz: int) -> list[str]:
    found = ["saturation empties the integrals by back-calculation, where PX4 stops them"]
    limits = ", ".join(f"{name} {given.get(name, 0.3):g}" for name in _LIMITS)
    found.append(f"the integrals have no limit, where PX4 has {limits}")
    if "MC_YAW_TQ_CUTOFF" not in given:
        found.append("MC_YAW_TQ_CUTOFF: 0, as `fly --autopilot` sets it, where PX4's own is 2")
    found += _describe_moving(given)
    off = [name for name in ("IMU_GYRO_CUTOFF", "IMU_DGYRO_CUTOFF") if given.get(name, 0.0) >= 0.5 * rate_hz]
    found += [f"{', '.join(off)}: off at this rate, of half of it at most"] if off else []
    if given.get("CA_AIRFRAME", 0.0) in _VTOL:
        found.append("a VTOL: its hover alone is judged")
    if given.get("THR_MDL_FAC", 0.0):
        found.append("THR_MDL_FAC: taken to make the thrust linear in the command")
    if any(name.startswith("CA_ROTOR") for name in given):
        found.append("CA_ROTOR…: not read, the vehicle file tells its rotors, or the torque that a log measured")
    return found


PX4 = AutopilotLoops(
    name="PX4",
    version="main of February 2025",
    later=later_defaults("px4"),
    rate_hz=250,
    settings=_settings(),
    whole=frozenset(),  # INT32 of IMU_ and MC_ are switches and rates that are not of the loops
    documented=_DOCUMENTED,
    family=("MC_", "IMU_"),
    moving=r"IMU_GYRO_DNF_\w+",
    known=r"MC_(ACRO|AT|MAN|ORBIT|SLOW|[RPY]R_INT)_\w+|MC_(AIRMODE|BAT_SCALE_EN)|IMU_(ACCEL|INTEG|GYRO_[CDFR])\w+",
    full_torque=_full_torque,
    build=_build,
    thrust_steps=1000,  # microseconds of a pulse, though its simulator gets fractions
    remarks=_remarks,
    gains=_GAINS,
    filters=r"IMU_D?GYRO_CUTOFF|IMU_GYRO_NF[01]_FRQ",
    strangers={},
    renamed={
        r"IMU_GYRO_NF_(FREQ|BW)": "IMU_GYRO_NF0_FRQ and _BW since PX4 1.13",
        "MC_DTERM_CUTOFF": "IMU_DGYRO_CUTOFF since PX4 1.11",
    },
    others={r"FW_[RPY]R_\w+": "plane", r"(GND|RD|RA|RM|RO)_\w+": "rover", r"UUV_\w+": "submarine"},
    hovers=_GAINS,
    classes={"CA_AIRFRAME": _CLASSES, "MAV_TYPE": _TYPES},
    loop_rate=("IMU_GYRO_RATEMAX", 100.0, 8000.0),
    rotors=_rotors,
)
