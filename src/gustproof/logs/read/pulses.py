"""Commands of the motors, from the pulses of the outputs that they are at."""

from collections.abc import Mapping

import numpy as np

from gustproof.types import Array

_FUNCTIONS = (*range(33, 41), *range(82, 86))  # ArduPilot's SERVOn_FUNCTION of motors 1 to 12
_PWM = {"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}  # [us] motor off and full, unless the parameters tell them
_QUADROTOR = (1, 2, 3, 4)


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
