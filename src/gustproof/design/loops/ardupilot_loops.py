"""ArduPilot's attitude and rate loops of a copter.

    gyro > harmonic notches > low-pass = omega
    target = angle P (attitude set-point - attitude) > low-pass FLTT;    e = target - omega > low-pass FLTE
    torque = P e + I sum + D (slope of e > low-pass FLTD) + FF target

A pass's rate loop runs before its estimator: its attitude, and so its target, is that of the previous sample.

References
----------
ArduPilot, libraries AC_AttitudeControl, AC_PID, Filter and AP_InertialSensor, Copter 4.7-dev of July 2025: order of
filters and loops, defaults.
"""

import math
from collections.abc import Mapping

from firmware_model.config.firmware import ardupilot_full_torque, measured_torque
from firmware_model.config.gyro_filters import ARDUPILOT_NOTCH, ARDUPILOT_NOTCHES, LOW_PASS_END, gyro_filters
from firmware_model.config.scenario import sample_time
from firmware_model.config.vehicle import Vehicle
from firmware_model.external.versions import later_defaults
from firmware_model.types import Vector
from gustproof.design.loops.filters import SampledAxisLoop, smoothing
from gustproof.design.loops.settings import FLOWN, AutopilotLoops, LoopSignals, Setting

_NAMES = ("RLL", "PIT", "YAW")
# AP_Int8, AP_Int16 or AP_Int32 in AP_InertialSensor.h and HarmonicNotchFilter.h of Copter 4.6
_WHOLE = frozenset(
    {"INS_GYRO_FILTER", *(f"{each}_{key}" for each in ARDUPILOT_NOTCHES for key in ("ENABLE", "HMNCS", "OPTS"))}
)
_ROTORS = {1: 4, 2: 6, 3: 8, 4: 8, 5: 6, 7: 3, 12: 12, 14: 10}  # by FRAME_CLASS
_STRANGERS = {
    r"Q_A_(RAT|ANG)_\w+": "gains of a quadplane (ArduPlane): to judge its hover, rename Q_A_ to ATC_ and Q_M_ to MOT_",
    r"RATE_(RLL|PIT|YAW)_\w+|STB_(RLL|PIT|YAW)_P": "names of ArduCopter before 3.4: its gains have another scale, and "
    "other names since, ATC_RAT_… and ATC_ANG_…",
}
_OTHERS = {
    r"(RLL|PTCH|YAW)(2SRV|_RATE)_\w+|TECS_\w+|KFF_\w+": "plane (ArduPlane)",
    r"ATC_(STR|SPEED|SAIL|BAL)_\w+|CRUISE_\w+": "rover or boat (ArduRover)",
    r"H_(COL|SW|RSC|TAIL|FLYBAR|SV)\w*|IM_\w+": "helicopter",
    r"JS_(GAIN|BTN)\w+": "submarine (ArduSub)",
}
_SWITCHES = {
    "FSTRATE_ENABLE": (0.0, "its rate loops run at the gyro's rate, faster than here"),
    "MOT_THST_EXPO": (0.65, "taken to make the thrust linear in the command"),
}
_UNMODELLED = ("SMAX", "PDMX", "D_FF", "NTF", "NEF")


# @Range in AC_AttitudeControl.cpp, AC_AttitudeControl_Multi.cpp and AP_InertialSensor.cpp of Copter 4.6
_DOCUMENTED: dict[str, tuple[float | None, float | None]] = {
    **{f"ATC_ANG_{axis}_P": (3.0, 12.0) for axis in ("RLL", "PIT", "YAW")},
    **{f"ATC_RAT_{axis}_P": (0.01, 0.5) for axis in ("RLL", "PIT")},
    **{f"ATC_RAT_{axis}_I": (0.01, 2.0) for axis in ("RLL", "PIT")},
    **{f"ATC_RAT_{axis}_D": (None, 0.05) for axis in ("RLL", "PIT")},
    **{f"ATC_RAT_{axis}_FLTD": (5.0, 100.0) for axis in ("RLL", "PIT")},
    "ATC_RAT_YAW_P": (0.1, 2.5),
    "ATC_RAT_YAW_I": (0.01, 1.0),
    "ATC_RAT_YAW_D": (None, 0.02),
    "ATC_RAT_YAW_FLTD": (5.0, 50.0),
    "INS_GYRO_FILTER": (None, 256.0),
}


def _settings() -> dict[str, Setting]:
    found = {}
    for name, (p, i, d), target, error in (
        ("RLL", (0.135, 0.135, 0.0036), 20.0, 0.0),
        ("PIT", (0.135, 0.135, 0.0036), 20.0, 0.0),
        ("YAW", (0.18, 0.018, 0.0), 20.0, 2.5),
    ):
        found[f"ATC_ANG_{name}_P"] = Setting(4.5, 1e-3, 100.0)
        rate = f"ATC_RAT_{name}_"
        found[f"{rate}P"], found[f"{rate}I"], found[f"{rate}D"] = (
            Setting(value, 0.0, high) for value, high in ((p, 100.0), (i, 1000.0), (d, 10.0))
        )
        found[f"{rate}FF"] = Setting(0.0, 0.0, 100.0)
        found[f"{rate}FLTT"], found[f"{rate}FLTE"] = Setting(target, 0.0, 1000.0), Setting(error, 0.0, 1000.0)
        found[f"{rate}FLTD"] = Setting(20.0, 0.0, 1000.0)
    for letter in "RPY":
        found[f"ATC_RATE_{letter}_MAX"] = Setting(0.0, 0.0, 1080.0)
    found["INS_GYRO_FILTER"] = Setting(20.0, 0.0, 1000.0)
    found["MOT_SPIN_MIN"], found["MOT_SPIN_MAX"] = Setting(0.15, 0.0, 0.3), Setting(0.95, 0.5, 1.0)
    for each in ARDUPILOT_NOTCHES:
        most = {"FREQ": 4000.0, "BW": 2000.0, "ATT": 200.0, "HMNCS": 65535.0, "OPTS": 65535.0}
        found[f"{each}_ENABLE"] = Setting(0.0, 0.0, 1.0)
        found |= {f"{each}_{key}": Setting(value, 0.0, most[key]) for key, value in ARDUPILOT_NOTCH.items()}
    return found


def _full_torque(vehicle: Vehicle, parameters: Mapping[str, float]) -> Vector:
    if measured := measured_torque("ardupilot", vehicle):
        return measured  # at the range of thrust that was flown
    roll, pitch, yaw = ardupilot_full_torque(vehicle)
    span = parameters["MOT_SPIN_MAX"] - parameters["MOT_SPIN_MIN"]
    return span * roll, span * pitch, span * yaw


def _build(axis: int, parameters: Mapping[str, float], full_torque: float, rate_hz: int) -> LoopSignals:
    name, dt = _NAMES[axis], sample_time(rate_hz)
    P, I, D, FF = (parameters[f"ATC_RAT_{name}_{gain}"] for gain in ("P", "I", "D", "FF"))  # noqa: E741
    to_target, to_error, to_slope = (
        smoothing(parameters[f"ATC_RAT_{name}_{key}"], rate_hz) for key in ("FLTT", "FLTE", "FLTD")
    )
    loop = SampledAxisLoop(dt)
    omega = loop.rate
    for each in gyro_filters("ardupilot", parameters, rate_hz):
        omega = loop.apply_filter(omega, each)
    commanded = parameters[f"ATC_ANG_{name}_P"] * (loop.reference - loop.attitude)
    target = loop.smooth(commanded, to_target)
    error = loop.smooth(target - omega, to_error)
    before = loop.state()
    integral = before + dt * error
    torque = full_torque * (P * error + I * integral + FF * target)
    if D > 0.0:
        torque += full_torque * D * loop.smooth((error - loop.delay(error)) / dt, to_slope)
    # Back-calculation, so that the integral empties with the time constant of the PI, as in `gustproof.law.cascade`.
    loop.set_next(before, integral, dt / (full_torque * P) if P > 0.0 else 0.0)
    most = parameters[f"ATC_RATE_{'RPY'[axis]}_MAX"]
    return LoopSignals(loop, torque, commanded, math.radians(most) if most > 0.0 else None)


def _rotors(given: Mapping[str, float]) -> tuple[str, int] | None:
    frame = int(given.get("FRAME_CLASS", 0))
    return (f"FRAME_CLASS {frame}", _ROTORS[frame]) if frame in _ROTORS else None


def _remarks(given: Mapping[str, float], rate_hz: int) -> list[str]:
    found = ["saturation empties the integrals by back-calculation, where ArduPilot stops their growth"]
    limits = ", ".join(f"{each} {given.get(f'ATC_RAT_{each}_IMAX', 0.5):g}" for each in _NAMES)
    found.append(f"the integrals have no limit, where ATC_RAT_…_IMAX are {limits}")
    found.append("angle errors beyond ATC_ACCEL_…_MAX / (2 P^2) ask for less rate than here")
    found.append("set-points move at once here, ArduPilot shapes them by ATC_INPUT_TC and ATC_SLEW_YAW")
    off = [f"ATC_RAT_{each}_{key}" for each in _NAMES for key in _UNMODELLED if given.get(f"ATC_RAT_{each}_{key}")]
    found += [f"{', '.join(off)}: left out"] if off else []
    for name in ARDUPILOT_NOTCHES:
        if (
            given.get(f"{name}_ENABLE")
            and given.get(f"{name}_MODE", 1.0)
            and given.get(f"{name}_REF", given.get(name + FLOWN))
        ):
            found.append(f"{name}: taken at {_describe_place(given, name)}, where ArduPilot moves it")
    if given.get("INS_GYRO_FILTER", 0.0) > (most := LOW_PASS_END * rate_hz):
        found.append(f"INS_GYRO_FILTER: taken at {most:g} Hz, the most at this rate; on board it has the gyro's rate")
    return found + [f"{name}: {meaning}" for name, (default, meaning) in _SWITCHES.items() if given.get(name, default)]


def _describe_place(given: Mapping[str, float], name: str) -> str:
    flown = given.get(name + FLOWN)
    return f"{flown:.0f} Hz, the median of the log's flight" if flown else f"its {name}_FREQ"


ARDUPILOT = AutopilotLoops(
    name="ArduPilot",
    version="Copter 4.7-dev of July 2025",
    later=later_defaults("ardupilot"),
    rate_hz=400,
    settings=_settings(),
    whole=_WHOLE,
    documented=_DOCUMENTED,
    family=("ATC_", "INS_GYRO_", "INS_HNT"),
    moving=r"INS_HNTC[H2]_(MODE|FM_RAT|FLOWN|ROTORS)",
    known=r"ATC_RAT_(RLL|PIT|YAW)_(IMAX|SMAX|PDMX|D_FF|NTF|NEF)|ATC_(ACCEL|ANGLE|ANG_LIM|INPUT|LAND|SLEW|THR)_\w+|"
    r"ATC_RATE_(FF_ENAB|WPY_MAX)|INS_GYRO_RATE|INS_HNTC[H2]_(MODE|REF|FM_RAT|FLOWN|ROTORS)",
    full_torque=_full_torque,
    build=_build,
    thrust_steps=1000,  # microseconds of a pulse
    remarks=_remarks,
    gains=r"ATC_(ANG_(RLL|PIT|YAW)_P|RAT_(RLL|PIT|YAW)_[PID])",
    filters=r"INS_GYRO_FILTER|INS_HNTC(H|2)_ENABLE",
    strangers=_STRANGERS,
    renamed={
        r"INS_NOTCH_\w+": "INS_HNTC2_… since Copter 4.2",
        r"ATC_RAT_(RLL|PIT|YAW)_FILT": "ATC_RAT_…_FLTD, or FLTE for yaw, since Copter 4.0",
    },
    others=_OTHERS,
    hovers=r"Q_A_(RAT|ANG)_\w+",
    classes={
        "FRAME_CLASS": {
            **dict.fromkeys((6.0, 11.0, 13.0), "helicopter"),
            8.0: "single copter",
            9.0: "coax copter",
            10.0: "bicopter",
        }
    },
    loop_rate=("SCHED_LOOP_RATE", 50.0, 2000.0),
    rotors=_rotors,
)
