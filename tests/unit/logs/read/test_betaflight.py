import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.read.flight_log import assumptions
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
    assert log.findings[:3] == (
        "gyro: no unit in the file, taken for deg/s, the default of its decoder since Betaflight 3.0; of older logs "
        "decode it with `--unit-rotation deg/s`",
        "motors: no unit in the file, taken for DShot by their numbers: 48 is off, 2047 full",
        "axes: Betaflight's pitch and yaw are turned, to front, right and down",
    )
    assert assumptions(log.findings) == list(log.findings[:2])


@pytest.mark.parametrize(("unit", "scale"), [("deg/s", math.pi / 180.0), ("rad/s", 1.0)])
def test_read_log_of_betaflight_takes_the_unit_of_its_columns(
    written: Write, betaflight_log: bytes, unit: str, scale: float
) -> None:
    names, _, rows = betaflight_log.decode().partition("\n")
    for axis in range(3):
        names = names.replace(f"gyroADC[{axis}]", f"gyroADC[{axis}] ({unit})")
    log = read_log(written("a.csv", f"{names}\n{rows}".encode()))
    assert log.gyro.values[31] == pytest.approx(scale * np.array([31.0, -20.0, 30.0]))
    assert not any(line.startswith("gyro: no unit") for line in log.findings)


def blackbox(gyro_per_dps: float = 1.0, fine: float = 1.0, stick: bool = True, setpoint: bool = True) -> bytes:
    """Return a table of a gyro that follows its set-points of up to 300 deg/s, and sticks at half of their travel."""
    time = np.arange(500)
    dps = 300.0 * np.sin(0.02 * np.outer(time, [1.0, 1.3, 0.7]))
    columns = {"loopIteration": time, "time (us)": 9_000_000 + 4000 * time}
    columns |= {f"axis{t}[{i}]": 10.0 * dps[:, i] for t in "PI" for i in range(3)}
    columns |= {f"rcCommand[{i}]": fine * (0.8 * dps[:, i] if i < 3 else 1500.0 + time / 2) for i in range(4 * stick)}
    columns |= {f"setpoint[{i}]": fine * dps[:, i] for i in range(3 * setpoint)}
    columns |= {f"gyroADC[{i}]": gyro_per_dps * dps[:, i] for i in range(3)}
    rows = np.column_stack(list(columns.values())).tolist()
    return "\n".join([", ".join(columns), *(", ".join(f"{each:.0f}" for each in row) for row in rows)]).encode()


def test_read_log_of_betaflight_holds_a_gyro_without_unit_against_its_set_points(written: Write) -> None:
    log = read_log(written("a.csv", blackbox()))
    assert log.findings[0] == "gyro: no unit in the file, taken for deg/s, as its set-points are"
    with pytest.raises(ConfigError, match=r"16\.4 times its set-points: decode it with `--unit-rotation deg/s`$"):
        read_log(written("a.csv", blackbox(16.4)))
    with pytest.raises(ConfigError, match=r"up to 4,920, which are no deg/s: decode it"):
        read_log(written("a.csv", blackbox(16.4, stick=False, setpoint=False)))
    with pytest.raises(ConfigError, match=r"up to 1,500, which are no deg/s: decode it"):
        read_log(written("a.csv", blackbox(5.0, setpoint=False)))


@pytest.mark.parametrize("is_told", [False, True])
def test_read_log_of_betaflight_knows_high_resolution(written: Write, is_told: bool) -> None:
    content = blackbox(10.0, 10.0, stick=not is_told)
    head = b'"Product","Blackbox flight data recorder"\n"blackbox_high_resolution",1\n' if is_told else b""
    log, usual = read_log(written("a.csv", head + content)), read_log(written("b.csv", blackbox()))
    assert log.rate_reference is not None
    assert usual.rate_reference is not None
    assert log.gyro.values == pytest.approx(usual.gyro.values, abs=0.01)
    assert log.rate_reference.values == pytest.approx(usual.rate_reference.values, abs=0.01)
    assert log.findings[0] == "file: of high resolution, taken for tenths: gyro, set-points and sticks"


def test_read_log_of_betaflight_takes_the_unit_of_its_time(written: Write, betaflight_log: bytes) -> None:
    names, _, rows = betaflight_log.partition(b"\n")
    lines = [line.split(b",") for line in rows.splitlines()]
    seconds = b"\n".join(b",".join([line[0], str(float(line[1]) * 1e-6).encode(), *line[2:]]) for line in lines)
    log = read_log(written("a.csv", names.replace(b"time (us)", b"time (s)") + b"\n" + seconds))
    assert log.gyro.time == pytest.approx(0.004 * np.arange(500), abs=1e-6)
    with pytest.raises(ConfigError, match=r"time: 0\.004 us between samples: decode it with `--unit-frame-time us`"):
        read_log(written("a.csv", names + b"\n" + seconds))


def test_read_log_of_betaflight_refuses_a_helicopter(written: Write, betaflight_log: bytes) -> None:
    with pytest.raises(ConfigError, match="Rotorflight, which flies helicopters"):
        read_log(written("a.csv", betaflight_log.replace(b"motor[3]", b"headspeed")))
