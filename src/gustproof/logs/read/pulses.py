"""Commands of the motors, from what the outputs that they are at were told: pulses [us], or numbers of DShot."""

from collections.abc import Mapping

import numpy as np

from gustproof.logs.read.flight_log import TAKEN
from gustproof.types import Array

_FUNCTIONS = (*range(33, 41), *range(82, 86))  # ArduPilot's SERVOn_FUNCTION of motors 1 to 12
_PWM = {"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}  # [us] motor off and full, unless the parameters tell them
_QUADROTOR = (1, 2, 3, 4)
_RARELY, _NEARLY, _MOSTLY = 0.01, 0.9, 0.5  # quantiles and a share of the outputs: damaged ones are rarer
_DSHOT, _LEAST_PWM = (48.0, 2047.0), 700.0  # DShot off and full; no pulse that turns a motor is shorter


def motor_commands(pulses_us: Mapping[int, Array], parameters: Mapping[str, float]) -> Array | None:
    """Return the commands (n, m) 0..1 in the order of the motors, of the pulses (n,) [us] by number of the output.

    Motors are at the outputs that ArduPilot's parameters name, else at the first four; `None` if these are absent.
    """
    functions = {output: parameters.get(f"SERVO{output}_FUNCTION", 0.0) for output in pulses_us}
    motors = sorted((_FUNCTIONS.index(int(what)), output) for output, what in functions.items() if what in _FUNCTIONS)
    outputs = [output for _, output in motors] or [output for output in _QUADROTOR if output in pulses_us]
    if not outputs:
        return None
    least, most = (parameters.get(name) or usual for name, usual in _PWM.items())
    values = np.column_stack([pulses_us[output] for output in outputs])
    return np.clip((values - least) / max(most - least, 1.0), 0.0, 1.0)


def output_commands(outputs: Array) -> Array:
    """Return the commands (n, m) 0..1 of motors by their outputs, pulses [us] or numbers of DShot.

    They are of DShot if motors turn at numbers that as pulses would stop them: sometimes much below, or nearly always.
    A number that is mostly the same is the pulse of parked motors.
    """
    least, most = _DSHOT if _is_dshot(outputs) else _PWM.values()
    return np.clip((outputs - least) / (most - least), 0.0, 1.0)


def describe_outputs(outputs: Array) -> str:
    """Return for what the outputs (n, m) of motors are taken, which no log tells."""
    kind, (least, most) = ("DShot", _DSHOT) if _is_dshot(outputs) else ("pulses in us", _PWM.values())
    return f"motors: no unit in the file{TAKEN}{kind} by their numbers: {least:.0f} is off, {most:.0f} full"


def describe_pulses(parameters: Mapping[str, float]) -> list[str]:
    """Return a line on the pulses of motors if parameters do not tell them all."""
    lacks = [name for name in _PWM if not parameters.get(name)]
    text = " to ".join(f"{parameters.get(name) or usual:.0f}" for name, usual in _PWM.items())
    return [f"motors: no {' and '.join(lacks)} in the log{TAKEN}pulses of {text} us"] if lacks else []


def _is_dshot(outputs: Array) -> bool:
    running = outputs[outputs > 0.0]
    is_dshot = len(running) > 0 and bool(np.quantile(running, _RARELY) < _LEAST_PWM)
    if len(running) and not is_dshot and np.quantile(running, _NEARLY) < _PWM["MOT_PWM_MIN"]:
        is_dshot = bool(np.unique(running, return_counts=True)[1].max() < _MOSTLY * len(running))
    return is_dshot
