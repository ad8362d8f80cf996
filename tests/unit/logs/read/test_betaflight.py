import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gustproof.logs.read.read_log import read_log

Write = Callable[[str, bytes], Path]
HEADERS = b'"Product","Blackbox flight data recorder by Nicholas Sherlock"\n"looptime",125\n'


def explorer(content: bytes) -> bytes:
    """Return a table as the Blackbox Explorer writes it."""
    names, _, rows = content.partition(b"\n")
    quoted = b",".join(b'"' + name.strip() + b'"' for name in names.replace(b"time (us)", b"time").split(b","))
    return HEADERS + quoted + b"\n" + rows


@pytest.mark.parametrize("change", [bytes, explorer])
def test_read_log_of_betaflight_turns_pitch_and_yaw(
    written: Write, betaflight_log: bytes, change: Callable[[bytes], bytes]
) -> None:
    log = read_log(written("btfl_001.01.csv", change(betaflight_log)))
    assert log.system == "betaflight"
    assert log.gyro.time == pytest.approx(0.004 * np.arange(500))
    assert log.gyro.values[31] == pytest.approx(np.deg2rad([31.0, -20.0, 30.0]))
    assert log.rate_reference is not None
    assert log.rate_reference.values[31] == pytest.approx(np.deg2rad([40.0, -30.0, -20.0]))
    assert not log.is_gyro_raw
    assert log.command is not None
    assert log.command.values[0] == pytest.approx([0.1, -0.075, 0.01])
    assert log.motors is not None
    assert log.motors.values[0] == pytest.approx([(747.0 - 48.0) / 1999.0] * 4)
    assert log.findings[:2] == (
        "axes: Betaflight's pitch and yaw are turned, to front, right and down",
        "gyro: no unit in the file, taken for deg/s",
    )


@pytest.mark.parametrize(("unit", "scale"), [("deg/s", math.pi / 180.0), ("rad/s", 1.0)])
def test_read_log_of_betaflight_takes_the_unit_of_its_columns(
    written: Write, betaflight_log: bytes, unit: str, scale: float
) -> None:
    names, _, rows = betaflight_log.decode().partition("\n")
    for axis in range(3):
        names = names.replace(f"gyroADC[{axis}]", f"gyroADC[{axis}] ({unit})")
    log = read_log(written("a.csv", f"{names}\n{rows}".encode()))
    assert log.gyro.values[31] == pytest.approx(scale * np.array([31.0, -20.0, 30.0]))
    assert not any("no unit" in line for line in log.findings)
