import re
from dataclasses import replace

import numpy as np
import pytest

from gustproof.logs.read.assemble import Draft, Rows, assemble, euler_angles, fastest


def rows(time_s: np.ndarray, values: np.ndarray, position: np.ndarray | None = None) -> Rows:
    place = np.arange(len(time_s)) if position is None else position
    return Rows(position=place, time_us=time_s * 1e6, values=values.reshape(len(time_s), -1))


def draft(time_s: np.ndarray, gyro: np.ndarray | None = None, **signals: Rows) -> Draft:
    noise = np.random.default_rng(1).normal(size=(len(time_s), 3)) if gyro is None else gyro
    return Draft(source="a.log", system="test", rows={"gyro": rows(time_s, noise), **signals})


def findings(log_draft: Draft, word: str) -> list[str]:
    return [line for line in assemble(log_draft).findings if word in line]


TIME = np.arange(2000) * 0.002
BESIDE = pytest.mark.parametrize(("times", "beyond"), [(0.96, False), (1.04, True)])
"""A share of a threshold, and whether it is beyond."""
LARGEST = {
    **{"gyro": 100.0, "command": 1e6, "motors": 1e3, "accelerometer": 2000.0},
    **{"attitude": 10.0, "reference": 10.0, "rate_reference": 100.0},
}
LEAST_SPIKE = {"gyro": 1.0, "command": 0.2, "motors": 0.2, "accelerometer": 20.0}


def test_assemble_starts_the_clock_at_the_first_sample_of_any_signal() -> None:
    log = assemble(draft(TIME + 1.7e9, attitude=rows(TIME[::10] + 1.7e9 - 0.5, np.zeros((200, 3)))))
    assert log.gyro.time[0] == pytest.approx(0.5, abs=1e-6)
    assert log.attitude is not None
    assert log.attitude.time[0] == 0.0


def test_assemble_keeps_the_longest_piece_of_a_clock_that_is_set_anew() -> None:
    clock = np.concatenate([TIME[:500] + 90.0, TIME[:1500]])
    motors = rows(np.concatenate([TIME[:500] + 90.0, TIME[:400]]), np.linspace(0.1, 1.0, 900))
    log = assemble(draft(clock, motors=motors))
    assert log.motors is not None
    assert (len(log.gyro.time), len(log.motors.time)) == (1500, 400)
    assert log.gyro.time[0] == 0.0
    assert "clock: set anew; the longest piece is kept, 3.0 s with 1,500 of 2,000 gyro samples" in log.findings


def test_assemble_leaves_out_what_follows_the_longest_piece() -> None:
    clock = np.concatenate([TIME[:1500], TIME[:500] + 1.0])  # set back
    place = np.concatenate([np.arange(400), np.arange(1500, 2000)])
    motors = rows(clock[place], np.linspace(0.1, 1.0, 900), place)
    log = assemble(draft(clock, motors=motors))
    assert log.motors is not None
    assert (len(log.gyro.time), len(log.motors.time)) == (1500, 400)
    assert not [line for line in log.findings if "left out" in line]  # none of the piece itself


PLACES = {
    "far future": ([700], 2.0**60 * 1e-6),
    "near future": ([700], TIME[700] + 0.1),
    "past": ([700], TIME[700] - 0.7),
    "zero": ([700], 0.0),
    "no number": ([700], np.nan),
    "repeated": ([700], TIME[699]),
    "the first": ([0], 1e9),
    "the last": ([1999], 1e9),
    "a block": (np.arange(700, 1100), TIME[700:1100] + 0.4),
    "a block long ago": (np.arange(700, 1100), TIME[700:1100] - 90.0),
    "a block of one stamp": (np.arange(700, 1100), 7.0),
    "many": (np.arange(100, 1900, 13), np.random.default_rng(5).uniform(-10.0, 10.0, size=139)),
}


@pytest.mark.parametrize("signal", ["gyro", "command", "motors", "attitude"])
@pytest.mark.parametrize("place", PLACES)
def test_assemble_leaves_out_wrong_stamps_alone(signal: str, place: str) -> None:
    which, stamps = PLACES[place]
    names = ("command", "motors", "attitude")
    damaged = draft(
        TIME + 3.0, **{name: rows(TIME + 3.0, np.sin(7.0 * TIME[:, None] + np.arange(3.0))) for name in names}
    )
    damaged.rows[signal].time_us[which] = 1e6 * stamps + 3e6
    log = assemble(damaged)
    for name in ("gyro", *names):
        kept = getattr(log, name).time / 0.002
        assert len(kept) == len(TIME) - len(which) * (name == signal)
        assert np.allclose(kept, np.rint(kept), atol=1e-6)
    told = [line for line in log.findings if "stamps are wrong" in line]
    assert told == [f"{signal}: {len(which):,} of 2,000 stamps are wrong, out of order or twice: left out"]


def test_assemble_keeps_all_but_one_of_two_stamps_that_changed_places() -> None:
    clock = TIME.copy()
    clock[[700, 701]] = clock[[701, 700]]
    assert len(assemble(draft(clock)).gyro.time) == 1999


@pytest.mark.parametrize("step_s", [0.5, 40.0])
def test_assemble_keeps_both_sides_of_a_clock_that_stepped_and_stayed(step_s: float) -> None:
    clock = np.where(np.arange(2000) < 700, TIME, TIME + step_s)
    log = assemble(draft(clock, command=rows(clock[::2], np.zeros((1000, 3)), position=np.arange(0, 2000, 2))))
    assert log.command is not None
    assert (len(log.gyro.time), len(log.command.time)) == (2000, 1000)
    assert any(line.endswith(f"longest gap {step_s + 0.002:.3g} s") for line in log.findings)


def test_assemble_leaves_out_commands_whose_clock_alone_stepped_and_stayed() -> None:
    clock = np.where(np.arange(2000) < 700, TIME, TIME + 30.0)
    log = assemble(draft(TIME, command=rows(clock, np.zeros((2000, 3)))))
    assert log.command is not None
    assert len(log.command.time) == 700


def test_assemble_leaves_out_samples_that_stand_out_alone() -> None:
    gyro, command = np.cumsum(np.random.default_rng(2).normal(size=(2, 2000, 3)), axis=1) * 1e-3
    gyro[1200, 1], command[900, 2], command[901, 0] = 80.0, -3e4, 0.9
    log = assemble(draft(TIME, gyro, command=rows(TIME, command)))
    assert log.command is not None
    assert (len(log.gyro.time), len(log.command.time)) == (1999, 1998)


def test_assemble_leaves_out_what_is_no_number_and_what_comes_twice() -> None:
    gyro = np.random.default_rng(2).normal(size=(2000, 3))
    gyro[5, 1], gyro[6, 2], gyro[7, 0] = np.nan, 1e30, np.inf
    clock = TIME.copy()
    clock[100] = clock[99]
    clock[200] = clock[190]
    log = assemble(draft(clock, gyro))
    assert len(log.gyro.time) == 1995
    assert "gyro: 3 of 2,000 samples are no plausible numbers: left out" in log.findings
    assert "gyro: 2 of 1,997 stamps are wrong, out of order or twice: left out" in log.findings


def test_assemble_tells_gaps_and_slow_signals() -> None:
    kept = np.delete(TIME, [50, 51, 52, 700])
    assert findings(draft(kept), "gaps") == ["gyro: 2 gaps, 4 samples lost (0.2 %), longest gap 0.008 s"]
    assert findings(draft(TIME[::10]), "Hz") == ["gyro: 50 Hz; identification needs 100 Hz or more"]
    assert not findings(draft(TIME), "gyro")


def test_assemble_tells_a_clipped_gyro() -> None:
    gyro = np.column_stack([40.0 * np.sin(3.0 * TIME), np.clip(40.0 * np.sin(3.0 * TIME), -34.9, 34.9), 0.0 * TIME])
    assert findings(draft(TIME, gyro), "clipped") == ["gyro: clipped at its range of 40 rad/s, axis y"]


def test_assemble_finds_the_stretches_in_the_air_by_the_motors() -> None:
    running = ((TIME > 0.3) & (TIME < 1.8)) | ((TIME > 2.0) & (TIME < 3.5)) | (TIME > 3.7)
    log = assemble(draft(TIME, motors=rows(TIME, np.where(running, 0.5, 0.05))))
    assert len(log.airborne) == 1
    assert log.airborne[0] == pytest.approx((0.302, 3.998), abs=1e-9)
    assert not findings(draft(TIME, motors=rows(TIME, 0.0 * TIME + 0.4)), "airborne")
    assert findings(draft(TIME), "airborne") == ["airborne: not told, and no motors: the whole log is taken"]


def test_assemble_takes_the_stretches_that_the_log_tells() -> None:
    told = draft(TIME)
    times = np.array([0.0, 0.3, 1.0, 2.5, 3.6])
    told.in_air = rows(times, np.array([1.0, 0.0, 1.0, 0.0, 1.0]), position=np.rint(times / 0.002))
    assert assemble(told).airborne == ((1.0, 2.5),)
    told.in_air.time_us[[2, 3]] = np.nan, 1e18
    assert assemble(told).airborne[0] == pytest.approx((1.0, 2.5), abs=1.0)
    told.in_air = rows(np.array([0.0, 3.4]), np.array([0.0, 1.0]), position=np.array([0, 1700]))
    assert assemble(told).airborne[0] == pytest.approx((3.4, 3.998))
    told.in_air = rows(np.array([0.0, 1.0, 40.0]), np.array([0.0, 1.0, 0.0]), position=np.array([0, 500, 5000]))
    assert assemble(told).airborne == (pytest.approx((1.0, 3.998)),)  # "8 s of log, 48 s in the air" was told
    told.in_air = rows(np.array([0.0]), np.array([0.0]))
    assert assemble(told).airborne == ()
    assert "airborne: never, by this log" in assemble(told).findings


def test_euler_angles_of_known_rotations() -> None:
    half = np.sqrt(0.5)
    q_NB = np.array(
        [[1.0, 0, 0, 0], [half, half, 0, 0], [half, 0, half, 0], [2.0 * half, 0, 0, 2.0 * half], [0, 0, 0, 0]]
    )
    angles = euler_angles(q_NB)
    assert angles[:2] == pytest.approx(np.array([[0, 0, 0], [np.pi / 2, 0, 0]]))
    assert angles[2, 1] == pytest.approx(np.pi / 2)
    assert angles[3] == pytest.approx([0, 0, np.pi / 2])
    assert np.all(np.isnan(angles[4]))


def test_assemble_without_a_motor_in_use_has_no_motors() -> None:
    log = assemble(draft(TIME, motors=rows(TIME, np.empty((2000, 0)))))
    assert log.motors is None
    assert any(re.fullmatch("not in this log: .*motors.*", line) for line in log.findings)


def test_one_sample_is_no_signal() -> None:
    log = assemble(draft(TIME, command=rows(TIME[:1], np.ones((1, 3))), motors=rows(TIME[:2], np.ones((2, 4)))))
    assert (log.command is None, log.motors is None) == (True, False)
    with pytest.raises(ValueError, match="no two gyro samples that can be used"):
        assemble(draft(TIME[:1]))


def test_assemble_refuses_a_vector_of_two() -> None:
    with pytest.raises(ValueError, match="gyro has 2 components, must have 3"):
        assemble(draft(TIME, gyro=np.zeros((2000, 2))))


def count(name: str, values: np.ndarray) -> int:
    """Return how many of a signal's samples are kept."""
    signals = {name: rows(TIME, values)}
    log = assemble(replace(draft(TIME), rows={**draft(TIME).rows, **signals}))
    return len(getattr(log, name).time)


@BESIDE
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("name", LARGEST)
def test_what_is_beyond_any_instrument_is_left_out(name, sign, times, beyond):
    values = np.zeros((2000, 3))
    values[700:703, 1] = sign * times * LARGEST[name]  # three in a row do not stand out alone
    assert count(name, values) == 2000 - 3 * beyond


@BESIDE
@pytest.mark.parametrize("slope", [1e-6, 1.0])
@pytest.mark.parametrize("name", LEAST_SPIKE)
def test_a_lone_spike_is_one_beyond_twenty_steps_and_its_least(name, slope, times, beyond):
    step = slope * LEAST_SPIKE[name]
    values = np.abs(np.arange(2000) % 40 - 20.0)[:, None] * np.array([step, 0.0, 0.0])
    values[700, 0] += step + times * max(20.0 * step, LEAST_SPIKE[name])
    assert count(name, values) == 2000 - beyond


@pytest.mark.parametrize("before", [15, 16])
def test_a_clock_is_set_anew_if_sixteen_samples_are_of_another(before):
    clock = np.concatenate([TIME[:before] + 90.0, TIME])
    assert len(findings(draft(clock), "set anew")) == (before == 16)


@BESIDE
def test_of_nearly_equal_rates_the_first_source_counts(times, beyond):
    slow, fast = (rows(TIME / each, np.zeros(2000)) for each in (0.8 * times, 1.0))
    assert fastest([slow, fast]) is (slow if beyond else fast)


@BESIDE
def test_findings_begin_at_their_thresholds(times, beyond):
    time = np.where(np.arange(2000) < 700, TIME, TIME + 0.002 * (1.5 * times - 1.0))
    assert bool(findings(draft(time), "gaps")) is beyond
    slow = np.arange(400) * 0.01 / (2.0 - times)  # [s] of 96 and 104 Hz
    assert bool(findings(draft(slow), "identification needs 100 Hz")) is beyond
    gyro = np.random.default_rng(1).uniform(-1.0, 1.0, (2000, 3))
    gyro[700:703, 1] = 3.0 * times
    assert bool(findings(draft(TIME, gyro), "clipped at its range")) is beyond
    gyro[702, 1] -= 0.01  # two in a row may be chance
    assert not findings(draft(TIME, gyro), "clipped at its range")


@BESIDE
def test_motors_fly_beyond_a_quarter_of_their_usual_command(times, beyond):
    motors = np.where(np.arange(2000) < 1000, 0.25 * times, 1.0)
    begin = assemble(draft(TIME, motors=rows(TIME, motors))).airborne[0][0]
    assert begin == pytest.approx(0.0 if beyond else 2.0)


@BESIDE
def test_a_state_whose_stamp_strayed_has_that_of_the_gyro(times, beyond):
    told = draft(TIME)
    told.in_air = Rows(
        position=np.array([0, 1000]),
        time_us=np.array([0.0, TIME[1000] * 1e6 - times * 1e6]),
        values=np.array([[0.0], [1.0]]),
    )
    assert assemble(told).airborne[0][0] == pytest.approx(TIME[1000] if beyond else TIME[1000] - times, abs=0.005)
