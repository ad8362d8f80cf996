import math
from pathlib import Path

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.read import table
from gustproof.logs.read.flight_log import CommandUnit
from gustproof.logs.read.flown_part import crop
from gustproof.logs.read.read_log import read_log


def write(path: Path, header: str, rows: np.ndarray) -> Path:
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=header, comments="")
    return path


@pytest.fixture
def flown() -> np.ndarray:
    time = np.arange(400) * 0.002
    return np.column_stack([time, *(np.sin((3.0 + i) * time) for i in range(3))])


def test_read_log_of_a_table_takes_columns_by_name_and_unit(tmp_path: Path, flown: np.ndarray) -> None:
    header = "# by hand\nr_dps, Time (ms),gyro_x [deg/s],q_radps,m1_us,m2_us,roll_cmd_nm,pitch_cmd_nm,yaw_cmd_nm,note"
    motors = np.linspace(1000.0, 2000.0, 400)
    columns = [flown[:, 3], 1e3 * flown[:, 0] + 77.0, flown[:, 1], flown[:, 2], motors, motors, *flown.T[1:], motors]
    log = read_log(write(tmp_path / "log.csv", header, np.column_stack(columns)))
    assert log.system == "csv"
    assert log.command_unit is CommandUnit.NEWTON_METRES
    assert np.allclose(log.gyro.time, flown[:, 0], atol=1e-9)
    assert np.allclose(log.gyro.values, flown[:, 1:] * [math.pi / 180.0, 1.0, math.pi / 180.0], atol=1e-8)
    assert log.motors is not None
    assert np.allclose(log.motors.values, np.column_stack([motors, motors]) / 1e3 - 1.0, atol=1e-8)
    assert log.command is not None
    assert np.allclose(log.command.values, flown[:, 1:], atol=1e-8)
    assert log.attitude is None


UNITS = {
    "gyro": ("p_{}", {"radps": 1.0, "rad_s": 1.0, "rad_per_s": 1.0}, {"dps": 1.0, "degps": 1.0, "deg_s": 1.0}),
    "motors": ("m1_{}", {"": 0.25, "pct": 25.0, "us": 1250.0, "pwm": 1250.0, "u16": 65535.0 / 4.0}),
    "accelerometer": ("ax_{}", {"mps2": -9.80665, "m_s2": -9.80665, "m_s_2": -9.80665, "g": -1.0}),
    "attitude": ("roll_{}", {"rad": 1.0}, {"deg": 1.0}),
    "command": ("roll_cmd_{}", {"": 0.5, "nm": 0.5, "n_m": 0.5}),
}
"""Names of a first column, and equal numbers by unit."""


@pytest.mark.parametrize("signal", UNITS)
def test_read_log_of_a_table_gives_the_same_number_in_each_unit(tmp_path: Path, signal: str) -> None:
    name, *groups = UNITS[signal]
    found = list[list[float]]()
    for group in groups:
        found.append([])
        for unit, number in group.items():
            names = [name.format(unit).strip("_")]
            others = {"p_": "qr", "ax": ("ay", "az"), "ro": ("pitch", "yaw"), "m1": ()}[names[0][:2]]
            names += [each + names[0].removeprefix("p").removeprefix("ax").removeprefix("roll") for each in others]
            columns = dict.fromkeys(("p_dps", "q_dps", "r_dps") if signal != "gyro" else (), 0.0)
            columns |= dict.fromkeys(names, number)
            rows = np.column_stack([np.arange(40) * 0.002, *(np.full(40, each) for each in columns.values())])
            log = read_log(write(tmp_path / "log.csv", ",".join(("time_s", *columns)), rows))
            found[-1].append(float(getattr(log, signal).values[0, 0]))
    first, *degrees = (set(np.round(each, 6)) for each in found)
    assert first == {{"motors": 0.25, "accelerometer": -9.80665, "command": 0.5}.get(signal, 1.0)}
    assert all(each == {round(math.pi / 180.0, 6)} for each in degrees)


@pytest.mark.parametrize(("unit", "second"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_read_log_of_a_table_gives_the_same_time_in_each_unit(tmp_path: Path, unit: str, second: float) -> None:
    rows = np.column_stack([second * np.arange(40) * 0.002, *[np.zeros(40)] * 3])
    log = read_log(write(tmp_path / "log.csv", f"t_{unit},p_dps,q_dps,r_dps", rows))
    assert log.gyro.time[-1] == pytest.approx(0.078)


@pytest.mark.parametrize("decimal", [",", "."])
def test_read_log_of_a_table_with_semicolons(tmp_path: Path, flown: np.ndarray, decimal: str) -> None:
    path = tmp_path / "log.csv"
    rows = [";".join(f"{number:.6f}".replace(".", decimal) for number in row) for row in flown]
    path.write_text("\n".join(["time_s;p_dps;q_dps;r_dps", *rows]))
    log = read_log(path)
    assert np.allclose(log.gyro.values, np.deg2rad(flown[:, 1:]), atol=1e-7)
    assert log.findings[0] == "file: semicolons separate its columns"


def test_read_log_of_a_table_leaves_out_empty_cells(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    lines = [f"{0.001 * i},0.1,.2,-.3," + (f"{0.01 * i},0,0" if i % 4 == 0 else ",,") for i in range(800)]
    path.write_text("t_s,p_rad_s,q_rad_s,r_rad_s,roll_deg,pitch_deg,yaw_deg\n" + "\n".join(lines))
    log = read_log(path)
    assert log.attitude is not None
    assert (len(log.gyro.time), len(log.attitude.time)) == (800, 200)
    assert log.attitude.values[-1, 0] == pytest.approx(math.radians(7.96))
    assert log.command_unit is CommandUnit.NORMALISED


@pytest.mark.parametrize(
    ("header", "fault"),
    [
        ("p_dps,q_dps,r_dps,x", "no column time_s"),
        ("time_s,p_dps,q_dps,x", "gyro: a column is missing: r_radps, "),
        ("time_s,p_dps,q,r_dps", "column 'q' does not say its unit: name it one of q_radps, "),
        ("time,p_dps,q_dps,r_dps", "no column time_s"),
        ("Timestamp,gyro.x,gyro.y,gyro.z", "a column 'timestamp' without a unit: if it is of the Crazyflie's client, "),
    ],
)
def test_read_log_of_a_table_names_the_missing_column(
    tmp_path: Path, flown: np.ndarray, header: str, fault: str
) -> None:
    path = write(tmp_path / "log.csv", header, flown)
    with pytest.raises(ConfigError) as told:
        read_log(path)
    assert str(told.value).startswith(f"{path}: {fault}")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("0,1,2,3\n0.1,a,2,3\n", "column 2: Row #2: CSV conversion error to double: invalid value 'a'"),
        ("0,1,2,3\n0.1,1,2\n", "CSV parse error: Row #2: Expected 4 columns, got 3: 0.1,1,2"),
        ("0,1,2,3\n", "no two gyro samples that can be used"),
        ("", "Empty CSV file"),
    ],
)
def test_read_log_of_a_table_names_the_bad_cell(tmp_path: Path, text: str, fault: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,p_dps,q_dps,r_dps\n" + text)
    with pytest.raises(ConfigError) as told:
        read_log(path)
    assert str(told.value) == f"{path}: {fault}"


def turning(seconds: float = 8.0) -> np.ndarray:
    """Return time [s], rates [rad/s], attitude [rad] and specific force [m/s^2] of a vehicle that rolls and pitches."""
    time = np.arange(0.0, seconds, 0.004)
    angles = np.column_stack([0.3 * np.sin(4.0 * time), 0.2 * np.sin(3.0 * time), 0.0 * time])
    rates = np.column_stack([1.2 * np.cos(4.0 * time), *(np.zeros_like(time),) * 2])
    pitching = 0.6 * np.cos(3.0 * time)
    rates[:, 1], rates[:, 2] = np.cos(angles[:, 0]) * pitching, -np.sin(angles[:, 0]) * pitching
    return np.column_stack([time, rates, angles, 0.0 * rates[:, :2], np.full_like(time, -9.8)])


NAMES = "{time},p_{rate},q_{rate},r_{rate},roll_{angle},pitch_{angle},yaw_{angle},ax_{force},ay_{force},az_{force}"
RIGHT = {"time": "time_s", "rate": "radps", "angle": "rad", "force": "mps2"}


@pytest.mark.parametrize(
    ("wrong", "signs", "fault"),
    [
        ({}, {}, ""),
        ({"rate": "dps"}, {}, "gyro and attitude contradict: 0.0174 times the rate"),
        ({"angle": "deg"}, {}, "gyro and attitude contradict: 56.6 times the rate"),
        ({}, {0: 2.0}, "gyro and attitude contradict: 2 times the rate"),
        ({"time": "t_ms"}, {}, "gyro: 2.5e+05 samples a second: is time in another unit?"),
        ({"force": "g"}, {}, "accelerometer: 96.1 m/s^2 in the median"),
        ({}, {9: -1.0}, "accelerometer: its z axis is up"),
        ({}, {2: -1.0}, "gyro and attitude contradict: pitch of opposite sign"),
        ({}, {2: -1.0, 5: -1.0}, ""),
        ({}, dict.fromkeys((1, 2, 3), 180.0 / math.pi), "gyro and attitude contradict: 57.3 times the rate"),
        ({}, dict.fromkeys((1, 2, 3), 6000.0 / math.pi), "gyro: beyond 4,000 deg/s"),
    ],
)
def test_read_log_of_a_table_refuses_units_and_axes_that_contradict_it(
    tmp_path: Path, wrong: dict[str, str], signs: dict[int, float], fault: str
) -> None:
    rows = turning()
    for column, factor in signs.items():
        rows[:, column] *= factor
    path = write(tmp_path / "log.csv", NAMES.format(**RIGHT | wrong), rows)
    if not fault:
        assert read_log(path).attitude is not None
        return
    with pytest.raises(ConfigError) as told:
        read_log(path)
    assert str(told.value).startswith(f"{path}: {fault}")


@pytest.mark.parametrize(("name", "full"), [("roll_cmd", "roll_cmd_nm"), ("m1", "m1_pct, m1_us, m1_u16")])
def test_read_log_of_a_table_refuses_commands_beyond_full_scale(
    tmp_path: Path, flown: np.ndarray, name: str, full: str
) -> None:
    others = "" if name == "m1" else ",pitch_cmd,yaw_cmd"
    header = f"time_s,p_dps,q_dps,r_dps,{name}{others}"
    command = np.abs(flown[:, 1:2]) * np.ones((1, header.count(",") - 3))
    assert read_log(write(tmp_path / "log.csv", header, np.hstack([flown, command]))).gyro.values.any()
    path = write(tmp_path / "log.csv", header, np.hstack([flown, 500.0 * command]))
    with pytest.raises(
        ConfigError, match=f"column '{name}' has no unit, then 1 is full; it reaches .*: name it {full}$"
    ):
        read_log(path)


def test_read_log_of_a_table_leaves_out_a_few_damaged_rows(tmp_path: Path, flown: np.ndarray) -> None:
    path = write(tmp_path / "log.csv", "time_s,p_dps,q_dps,r_dps", flown)
    lines = path.read_bytes().splitlines()
    lines[50:55] = [b'0.098,"1,2,3', b"0.1,x,2,3", b"0.102,1,2", b"\0\xff,1,2,3", b"0.106,,2,3"]
    path.write_bytes(b"\n".join(lines)[:-9])  # cut off within a row
    log = read_log(path)
    assert len(log.gyro.time) == 396
    assert log.findings[0] == "file: 3 rows are damaged: left out"


@pytest.mark.parametrize("damaged", [19, 20])
def test_read_log_of_a_table_refuses_more_than_a_twentieth_of_damaged_rows(
    tmp_path: Path, flown: np.ndarray, damaged: int
) -> None:
    path = write(tmp_path / "log.csv", "time_s,p_dps,q_dps,r_dps", flown)
    lines = path.read_bytes().splitlines()
    lines[50 : 50 + damaged] = [b"x,1,2,3"] * damaged
    path.write_bytes(b"\n".join(lines))
    if damaged / (len(flown) - damaged) > 0.05:
        with pytest.raises(ConfigError, match="invalid value 'x'"):
            read_log(path)
    else:
        assert read_log(path).findings[0] == f"file: {damaged} rows are damaged: left out"


def test_read_log_of_a_table_bounds_what_it_reads(
    tmp_path: Path, flown: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "log.csv", "time_s,p_dps,q_dps,r_dps", flown)
    monkeypatch.setattr(table, "_NUMBERS", 1000)
    with pytest.raises(ConfigError, match="more than 1,000 numbers"):
        read_log(path)
    monkeypatch.setattr(table, "_LARGEST", 1000)
    with pytest.raises(ConfigError, match="is larger than"):
        read_log(path)
    path.write_text(",".join(map(str, range(2000))))
    monkeypatch.undo()
    with pytest.raises(ConfigError, match="2,000 columns"):
        read_log(path)


def test_a_crop_is_the_flight_and_nothing_is_said_of_the_whole_log(tmp_path: Path, flown: np.ndarray) -> None:
    log = read_log(write(tmp_path / "log.csv", "time_s,p_radps,q_radps,r_radps", flown))
    assert crop(log, None, None) is log
    assert any(line.startswith("airborne: not told") for line in log.findings)
    for ends, airborne in (((0.2, None), (0.2, 0.798)), ((None, 0.5), (0.0, 0.5)), ((0.1, 0.3), (0.1, 0.3))):
        found = crop(log, *ends)
        assert found.airborne == (pytest.approx(airborne),)
        assert not any(line.startswith("airborne: ") for line in found.findings)
    for ends in ((0.5, 0.5), (0.5, 0.2), (-0.1, 0.5), (0.1, 0.9), (math.nan, 0.5)):
        with pytest.raises(ConfigError, match=r"in order and within the log, 0 \.\. 0\.798 s"):
            crop(log, *ends)
