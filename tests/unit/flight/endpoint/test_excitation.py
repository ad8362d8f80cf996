import numpy as np
import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import RejectReason
from firmware_model.mavlink.messages import heartbeat_message
from firmware_model.types import ImuSample
from gustproof.errors import FlightError
from gustproof.flight.endpoint import excitation
from gustproof.flight.endpoint.endpoint import ControllerOutcome
from gustproof.flight.endpoint.excitation import (
    _AXIS_S,
    _MEASURED_S,
    _SETTLE_S,
    DT,
    _excitation,
    _excitation_law,
    _Recorder,
)


def test_records_are_the_measured_part_of_each_axis_after_it_settled():
    added = dict(_excitation())
    recorder, k, whole, start_us, step_us = _Recorder(), 0, False, 500_000, round(1e6 * DT)
    while not whole:
        sample = ImuSample(start_us + k * step_us, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
        whole = recorder.add(sample, added.get(k * step_us, (0.0, 0.0, 0.0)))
        recorder.add(sample, (9.0, 9.0, 9.0))  # repeated
        k += 1
    assert (k - 1) * DT == 75.0 + DT  # longer than 75 s
    for axis, record in enumerate(recorder.split()):
        begin = axis * _AXIS_S + _SETTLE_S
        assert record.time[[0, -1]] == pytest.approx([begin, begin + _MEASURED_S - DT], abs=1.5 * DT)
        expected = [added[step_us * round(time / DT)][axis] for time in record.time]
        assert np.array_equal(record.command, expected)
        assert np.ptp(record.command) > 0.5
        assert set(record.rate) == {axis + 1.0}


def test_the_law_commands_its_reference_against_its_attitude():
    law, attitude, reference = _excitation_law(), np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.6, 0.7])
    command = law.C @ np.concatenate([attitude, np.zeros(3)]) + law.D[:, 3:] @ reference
    assert command == pytest.approx(reference - 0.5 * attitude)
    assert np.array_equal(law.G[:3], DT * np.eye(3))


def test_sines_turn_the_vehicle_little_and_their_sum_peaks_low():
    """No sine turns it by more than .06 rad, or faster than .1 rad/s: .06 rad of the two below 1.67 rad/s."""
    added = np.array([rates for _, rates in _excitation()])[:, 0]
    periods = added[750:5750]  # two of 10 s, after 3 s
    size = np.abs(np.fft.rfft(periods)) / 2500.0
    lines = np.flatnonzero(size > 1e-9)
    assert lines.tolist() == [4, 6, 10, 16, 26, 42, 68, 110]  # of 20 s
    omega = lines * 2.0 * np.pi / 20.0
    assert size[lines] == pytest.approx(np.where(omega < 1.67, 0.06 * omega, 0.1))
    assert np.max(np.abs(periods)) == pytest.approx(0.5794925)  # phases after Schroeder; alike they add up to .775
    assert _excitation_law().limits.tolist() == [1.0] * 3


@pytest.mark.parametrize(
    ("outcome", "raised"),
    [(ControllerOutcome.INTERRUPTED, KeyboardInterrupt), (ControllerOutcome.MODE_LOST, FlightError)],
)
def test_a_flight_that_ends_early_gives_no_records_and_no_unsigned_message_counts(
    monkeypatch, tmp_path, outcome, raised
):
    (tmp_path / "key").write_bytes(bytes(range(32)))
    (tmp_path / "key").chmod(0o600)
    handlers = []

    def serve(endpoint, target, bind_port, _):
        beat = heartbeat_message(0, False, critical=False).pack(wire.MAVLink(None, 3, 1))
        endpoint.receive(beat, (0, target.address), 0)
        assert endpoint.channel.dropped == {RejectReason.NOT_SIGNED: 1}
        assert (handlers, bind_port) == ([endpoint.interrupt], 14550)
        assert (endpoint._hold_height, endpoint._correct_attitude) == (True, True)
        endpoint._end(outcome, "the pilot took over")

    monkeypatch.setattr(excitation.connection, "serve", serve)
    monkeypatch.setattr(excitation, "call_on_interrupt", handlers.append)
    with pytest.raises(raised, match=None if raised is KeyboardInterrupt else "the pilot took over"):
        excitation.fly_excitation("127.0.0.1:14580", print, bind_port=14550, signing_key=tmp_path / "key")
