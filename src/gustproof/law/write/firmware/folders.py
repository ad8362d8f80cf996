"""A law as a folder that builds inside PX4, ArduPilot or the Crazyflie's firmware.

All three fly the same unit in C: the law, and around it the start at the present attitude, lost samples and frames.
Templates are files of this package with `string.Template` placeholders.
"""

from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from string import Template

import numpy as np

from firmware_model.config.firmware import (
    LAW_GYRO_FILTER_HZ,
    ardupilot_full_torque,
    ardupilot_parameters,
    check_measured,
    hover_fraction,
    is_measured,
    measured_torque,
    px4_full_torque,
    px4_parameters,
)
from firmware_model.config.vehicle import FullScale, Vehicle, list_vehicles
from firmware_model.errors import ConfigError
from firmware_model.external.versions import describe_tried
from firmware_model.types import AXES, Vector
from gustproof.law.form import Law, Output
from gustproof.law.write.c import AttitudeSource, c_name, c_unit
from gustproof.version import __version__

_DATA = Path(__file__).parent / "data"
_MODE_LENGTH = 24  # of PX4's names of modes
_MAIN_LOOP = 1000  # [Hz] of the Crazyflie
_MAKEUP = 5  # steps in a row for lost samples: less than the time in which a sound law loses its vehicle
_FADE = 2.0  # [s] in which the torque of the loops before fades: no shorter than a law's integrators need
_LINEAR = "- The law is linear: it counts roll and pitch from the attitude at its start, so start it level.\n"
_PX4_SCALE = """for the geometry in
  `vehicle.txt` and motors whose thrust is linear in the command: `THR_MDL_FAC` makes others so."""
_ARDUPILOT_SCALE = """for a quadrotor X whose motors
  are linear from no thrust to full thrust. `MOT_THST_EXPO` makes others so."""
_MEASURED_SCALE = """as the vehicle's flight log
  measured it, with the frame, the motors and the hover thrust of that flight: this folder leaves those alone."""
_GYRO_RATES = (100, 250, 400, 800, 1000, 2000)  # [Hz] PX4's IMU_GYRO_RATEMAX
_LEVEL_AND_HEIGHT, _POSITION = 1, 2  # PX4's GP_HOLD


class Firmware(Enum):
    """Autopilot that a law is exported for."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"
    CRAZYFLIE = "crazyflie"


RATES = {Firmware.PX4: 250, Firmware.ARDUPILOT: 400, Firmware.CRAZYFLIE: 250}
"""[Hz] Rate of each by default: that of its simulator, of its loop, and one that the main loop allows."""


def firmware_folder(
    firmware: Firmware,
    law: Law,
    vehicle: Vehicle,
    attitude: AttitudeSource,
    folder: str,
    *,
    verdict: str,
    single: bool = False,
) -> dict[str, str]:
    """Return the files of a folder by their paths in it; the law has the target's rate already.

    `folder` is what the commands of its README call it, `verdict` what it says of the loop on the vehicle. The
    Crazyflie's unit is `single`, in single precision, anyway, but for laws that read the accelerometer: those have no
    such form.

    Raises
    ------
    ConfigError
        If the law commands no torque, or its rate is none of the target's. If the vehicle has another shape than that
        of the target's mixer, or the torque of the target's commands is not known.
    """
    check_measured(vehicle)
    if law.output is not Output.TORQUE:
        raise ConfigError(f"law '{law.name}' commands rates: inside an autopilot a law must command torque")
    single = single or (firmware is Firmware.CRAZYFLIE and not law.uses_accelerometer)
    words = _words(law, vehicle, attitude, folder) | {"verdict": verdict, "real": "float" if single else "double"}
    write = {Firmware.PX4: _px4, Firmware.ARDUPILOT: _ardupilot, Firmware.CRAZYFLIE: _crazyflie}[firmware]
    return write(law, vehicle, words, _units(law, attitude, words, single=single))


def _words(law: Law, vehicle: Vehicle, attitude: AttitudeSource, folder: str) -> dict[str, str]:
    return {
        "name": law.name,
        "version": __version__,
        "prefix": c_name(law.name),
        "rate": str(round(1.0 / law.dt)),
        "vehicle": vehicle.name,
        "option": _vehicle_option(vehicle.name),
        "mass": f"{vehicle.mass:g}",
        "attitude": "the autopilot's estimate"
        if attitude is AttitudeSource.AUTOPILOT
        else "the law's own, from the gyro",
        "linear": "" if law.is_scheduled else _LINEAR,
        "folder": folder,
    }


def _vehicle_option(name: str) -> str:
    """Return what names a vehicle on the command line, where it is not the default one."""
    file = name if name in list_vehicles() else f"{name}.toml"
    return "" if name == "paper" else f" --vehicle {file}"


def _units(law: Law, attitude: AttitudeSource, words: Mapping[str, str], *, single: bool) -> dict[str, str]:
    """Return the four files in C that all targets have."""
    unit = c_unit(law, "gustproof_law.h", attitude, single=single)
    real, more = words["real"], []
    if law.uses_accelerometer:
        more += ["for (int i = 0; i < 3; i++)", f"    y[6 + i] = ({real})now->force[i];"]
    if attitude is AttitudeSource.AUTOPILOT:
        own = f"{words['prefix']}_MEASURED - 3"
        more += [
            f"present_attitude(now, y + {own});",
            "for (int i = 0; i < 3; i++)",
            f"    y[{own} + i] -= law->origin[i];",
        ]
    inside = {
        **words,
        "origin": "0, 0 and the yaw at the start" if law.is_scheduled else "those at the start",
        "first": "2" if law.is_scheduled else "0",
        "yaw": f"law->x[{words['prefix']}_PSI]" if law.is_scheduled else f"({real})0",
        "makeup": str(_MAKEUP),
        "fade": f"{_FADE}f",
        "more": "".join(f"    {line}\n" for line in more),
    }
    texts = {name: _fill(f"common/{name}", inside) for name in ("gustproof_inside.h", "gustproof_inside.c")}
    return {"gustproof_law.h": unit.header, "gustproof_law.c": unit.source, **texts}


def _px4(law: Law, vehicle: Vehicle, words: dict[str, str], units: dict[str, str]) -> dict[str, str]:
    rate = round(1.0 / law.dt)
    if rate not in _GYRO_RATES:
        raise ConfigError(f"--rate: is {1.0 / law.dt:g} Hz, PX4's gyro has {', '.join(map(str, _GYRO_RATES))} Hz")
    measured = measured_torque("px4", vehicle)
    words |= _torques(measured or px4_full_torque(vehicle.rotors)) | {
        "tried": describe_tried("px4", with_law=True),
        "scale": _MEASURED_SCALE if measured else _PX4_SCALE,
        "mode": f"gustproof {law.name}"[:_MODE_LENGTH],
        "takes_references": "true" if law.takes_references else "false",
        "hold": str(_POSITION if law.takes_references else _LEVEL_AND_HEIGHT),
    }
    frame = {} if measured else px4_parameters(vehicle)
    parameters = frame | {"IMU_GYRO_RATEMAX": str(rate), "IMU_GYRO_CUTOFF": f"{LAW_GYRO_FILTER_HZ:g}"}
    module = "src/modules/gustproof"
    return {
        "README.md": _fill("px4/README.md", words),
        "src/CMakeLists.txt": _fill("px4/CMakeLists.txt", {}),
        "vehicle.txt": "".join(f"param set {name} {value}\n" for name, value in parameters.items()),
        **{f"{module}/{name}": _fill(f"px4/module/{name}", words) for name in _list("px4/module")},
        **{f"{module}/{name}": text for name, text in units.items()},
    }


def _ardupilot(law: Law, vehicle: Vehicle, words: dict[str, str], units: dict[str, str]) -> dict[str, str]:
    rate = round(1.0 / law.dt)
    if abs(rate * law.dt - 1.0) > 1e-9 or not 50 <= rate <= 2000:
        raise ConfigError(f"--rate: is {1.0 / law.dt:g} Hz, ArduPilot's loop has whole Hz of 50 to 2000")
    if measured := measured_torque("ardupilot", vehicle):
        span = vehicle.command.thrust_range if vehicle.command else 1.0
        frame, full = {}, (measured[0] / span, measured[1] / span, measured[2] / span)
    else:
        frame, full = ardupilot_parameters(vehicle), ardupilot_full_torque(vehicle)
    words |= _torques(full) | {"scale": _MEASURED_SCALE if measured else _ARDUPILOT_SCALE}
    words["tried"] = describe_tried("ardupilot", with_law=True)
    own = {
        "SCHED_LOOP_RATE": str(rate),
        "INS_GYRO_FILTER": f"{LAW_GYRO_FILTER_HZ:g}",
        "CC_TYPE": "3",
        "CC_AXIS_MASK": "7",
    }
    parameters = frame | own | {"RC6_OPTION": "109"}
    library = "libraries/AC_CustomControl"
    sources = ("AC_CustomControl_Gustproof.h", "AC_CustomControl_Gustproof.cpp")
    return {
        "README.md": _fill("ardupilot/README.md", words),
        "edits.patch": _fill("ardupilot/edits.patch", {}),
        "vehicle.parm": "".join(f"{name},{value}\n" for name, value in parameters.items()),
        **{f"{library}/{name}": _fill(f"ardupilot/{name}", words) for name in sources},
        **{f"{library}/{name}": text for name, text in units.items()},
    }


def _crazyflie(law: Law, vehicle: Vehicle, words: dict[str, str], units: dict[str, str]) -> dict[str, str]:
    rate = round(1.0 / law.dt)
    if abs(rate * law.dt - 1.0) > 1e-9 or _MAIN_LOOP % rate:
        raise ConfigError(f"--rate: is {1.0 / law.dt:g} Hz, must divide the Crazyflie's loop of {_MAIN_LOOP} Hz")
    if is_measured(vehicle) or (vehicle.command and vehicle.command.full_scale is FullScale.UNKNOWN):
        raise ConfigError(
            f"vehicle '{vehicle.name}': its rotors are assumed, and the Crazyflie's firmware turns N m into motor "
            "commands by them: identify it with --like, a vehicle of these rotors"
        )
    ardupilot_parameters(vehicle)  # the same order of rotors
    arms = np.linalg.norm(np.array(vehicle.rotors.position_B)[:, :2], axis=1)
    sides = np.abs(np.array(vehicle.rotors.position_B)[:, :2])
    if np.ptp(sides) > 0.01 * np.max(sides):
        raise ConfigError(f"vehicle '{vehicle.name}': the Crazyflie's mixer is for rotors in a square")
    words |= {
        "arm": f"{arms[0]:.4g}",
        "thrust": f"{vehicle.rotors.thrust_max:.6g}",
        "ratio": f"{vehicle.rotors.drag_ratio:.6g}",
        "hover": str(round(65535 * hover_fraction(vehicle))),
    }
    return {
        "README.md": _fill("crazyflie/README.md", words),
        "Makefile": _fill("crazyflie/Makefile", {}),
        "Kbuild": _fill("crazyflie/Kbuild", {}),
        "app-config": _fill("crazyflie/app-config", {}),
        "src/Kbuild": _fill("crazyflie/src.Kbuild", {}),
        "src/gustproof.c": _fill("crazyflie/gustproof.c", words),
        **{f"src/{name}": text for name, text in units.items()},
    }


def _torques(full: Vector) -> dict[str, str]:
    """Return the torque [N*m] of full commands as C numbers."""
    return {f"{axis}_torque": f"{value:.7g}f" for axis, value in zip(AXES, full, strict=True)}


def _list(folder: str) -> list[str]:
    return sorted(path.name for path in (_DATA / folder).iterdir())


def _fill(template: str, words: Mapping[str, str]) -> str:
    return Template((_DATA / template).read_text(encoding="utf-8")).substitute(words)
