from dataclasses import replace

import numpy as np
import pytest

from gustproof.logs.identify.spectra import frequency_response
from gustproof.logs.identify.stretches import cut_stretch, find_stretches, hold_out, limit_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal


def _signal(begin: float, end: float, dt: float, *lost: tuple[float, float]) -> LogSignal:
    time = np.arange(begin, end, dt)
    kept = np.all([(time < a) | (time >= b) for a, b in lost], axis=0) if lost else np.full(len(time), True)
    return LogSignal(time=time[kept], values=np.column_stack([time[kept]] * 3))


def test_stretches_end_at_long_gaps_of_either_signal():
    log = FlightLog(source="x", system="csv", gyro=_signal(0.0, 30.0, 0.002, (10.0, 10.5), (12.0, 12.02)))
    command = _signal(0.5, 29.0, 0.004, (20.0, 21.0))
    assert find_stretches(log, command) == [
        pytest.approx(span) for span in ((0.5, 9.998), (10.5, 19.996), (21.0, 28.996))
    ]
    within = _signal(0.5, 29.0, 0.004, (9.0, 13.0))  # a gap that holds those of the gyro
    assert find_stretches(log, within) == [pytest.approx(span) for span in ((0.5, 8.996), (13.0, 28.996))]
    flown = replace(log, airborne=((2.0, 8.0), (15.0, 17.0)))
    assert find_stretches(flown, command) == [pytest.approx((3.5, 6.5))]


@pytest.mark.parametrize(("dt", "longest"), [(0.002, 0.1), (0.05, 0.15)])
def test_a_gap_is_long_beyond_a_tenth_of_a_second_and_three_samples(dt, longest):
    for gap in (0.97 * longest, 1.03 * longest):
        time = np.concatenate([np.arange(0.0, 10.0, dt), np.arange(10.0 - dt + gap, 20.0, dt)])
        gyro = LogSignal(time=time, values=np.zeros((len(time), 3)))
        spans = find_stretches(FlightLog(source="x", system="csv", gyro=gyro), gyro)
        assert len(spans) == 1 + (gap > longest)


@pytest.mark.parametrize(("flown", "used"), [(1.99, 0), (2.0, 1)])
def test_a_stretch_of_two_seconds_beside_the_ground_is_used(flown, used):
    gyro = _signal(0.0, 30.0, 0.002)
    log = FlightLog(source="x", system="csv", gyro=gyro, airborne=((4.0, 7.0 + flown),))
    assert len(find_stretches(log, gyro)) == used


def test_every_third_piece_is_held_out_across_spans():
    learnt, rest = hold_out([(0.0, 30.0), (100.0, 160.0)])
    assert learnt == [pytest.approx(span) for span in ((0.0, 20.0), (100.0, 120.0), (130.0, 150.0))]
    assert rest == [pytest.approx(span) for span in ((20.0, 30.0), (120.0, 130.0), (150.0, 160.0))]
    short, last = hold_out([(1.0, 7.0)])
    assert (short, last) == ([pytest.approx((1.0, 5.0))], [pytest.approx((5.0, 7.0))])


def test_long_logs_are_cut_to_their_liveliest_pieces():
    command = _signal(0.0, 100.0, 0.01)
    lively = (command.time > 40.0) & (command.time < 60.0)
    command = LogSignal(time=command.time, values=np.where(lively, np.sin(30.0 * command.time), 0.0)[:, None])
    assert limit_time([(0.0, 100.0)], command, 20.0) == [(40.0, 50.0), (50.0, 60.0)]
    assert limit_time([(0.0, 15.0)], command, 20.0) == [(0.0, 15.0)]


def test_bins_average_what_is_there_and_lost_commands_are_filled():
    gyro, command = _signal(0.0, 5.0, 0.001, (2.0, 2.006)), _signal(0.0, 5.0, 0.004, (3.0, 3.02))
    stretch = cut_stretch(gyro, command, 0.0, 5.0)
    assert stretch.rate[:, 0] == pytest.approx(stretch.time, abs=1e-9)
    assert stretch.count.sum() == len(stretch.gyro_time)
    assert np.median(stretch.count) == 4.0  # of 4 ms
    assert stretch.gyro_time[0] == pytest.approx(0.35)  # the actuators' state is unknown before
    assert np.diff(stretch.command_time) == pytest.approx(np.full(len(stretch.command_time) - 1, 0.004))
    assert stretch.command[:, 0] == pytest.approx(stretch.command_time)


def test_reference_is_an_instrument_against_the_disturbance():
    """In a closed loop the direct response leans to that of the inverse controller; the instrument's does not."""
    random, dt, n = np.random.default_rng(5), 0.01, 60_000
    reference, disturbance = random.standard_normal((2, n))
    command, rate = np.zeros(n), np.zeros(n)
    for k in range(n - 1):
        command[k] = 2.0 * (reference[k] - rate[k])
        rate[k + 1] = rate[k] + dt * (3.0 * command[k] + 20.0 * disturbance[k])
    truth = 3.0
    direct = frequency_response([(command, rate, None)], dt, 3.0)
    free = frequency_response([(command, rate, reference)], dt, 3.0)
    low = direct.omega < 4.0
    assert np.median(np.abs(free.response[low])) == pytest.approx(truth, rel=0.15)
    assert np.median(np.abs(direct.response[low])) < 0.8 * truth
    assert np.all((free.coherence >= 0.0) & (free.coherence <= 1.0))
