"""Flight that excites an autopilot's rate loop, axis by axis, over MAVLink, and records commands and rates."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from firmware_model.process import access
from firmware_model.process.interrupts import call_on_interrupt
from firmware_model.types import ImuSample, Vector
from gustproof.errors import FlightError
from gustproof.flight.endpoint import connection
from gustproof.flight.endpoint.core import References
from gustproof.flight.endpoint.endpoint import ControllerEndpoint, ControllerOutcome
from gustproof.law.form import Law, Matrix, Output, Provenance

DT = 0.004
"""[s] sample time of the excitation."""
_PERIOD_S = 10.0
OMEGA: Matrix = np.array([2.0, 3.0, 5.0, 8.0, 13.0, 21.0, 34.0, 55.0]) * (2.0 * math.pi / _PERIOD_S)
"""(8,) [rad/s] sines of the excitation, 1.3 to 35."""
_AMPLITUDE: Matrix = np.minimum(0.06 * OMEGA, 0.1)  # [rad/s] each; no sine turns the vehicle by more than 3.5 deg
_PHASE: Matrix = -math.pi * np.arange(OMEGA.size) ** 2 / OMEGA.size  # Schroeder's: a small peak
_SETTLE_S, _MEASURED_S, _PAUSE_S = 3.0, 2.0 * _PERIOD_S, 2.0
_AXIS_S = _SETTLE_S + _MEASURED_S + _PAUSE_S
_HOLD = 0.5  # [1/s] rate command per attitude error, so that the vehicle stays level
_RATE_LIMIT = 1.0  # [rad/s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisRecord:
    """Record of the excitation of one axis."""

    time: Matrix
    """(n,) [s] stamps."""
    command: Matrix
    """(n,) [rad/s] B, commanded after the sample."""
    rate: Matrix
    """(n,) [rad/s] B, of the gyro."""


def fly_excitation(
    connect: str,
    report: Callable[[str], None],
    *,
    bind_port: int | None = None,
    signing_key: Path | None = None,
) -> tuple[AxisRecord, ...]:
    """Fly the excitation on a vehicle that hovers under its pilot, and return the records of roll, pitch and yaw.

    It takes 75 s; then the vehicle is handed back. `connect` and the other options are those of the controller.

    Raises
    ------
    ConfigError
        If an option is wrong.
    FlightError
        If the flight does not begin, or ends early.
    """
    target = connection.parse_target(connect)
    recorder = _Recorder()
    endpoint = ControllerEndpoint(
        _excitation_law(),
        (0, target.address),
        access.make_signing(target.address[0], signing_key, strict=True),
        _excitation(),
        report,
        hold_height=True,
        correct_attitude=True,
        recorder=recorder.add,
    )
    call_on_interrupt(endpoint.interrupt)
    connection.serve(endpoint, target, bind_port, report)
    if endpoint.outcome is ControllerOutcome.INTERRUPTED:
        raise KeyboardInterrupt
    if endpoint.outcome is not ControllerOutcome.DONE:
        raise FlightError(endpoint.message)
    return recorder.split()


class _Recorder:
    """Samples and commands of a flight from its first sample; a flight that was interrupted begins again."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, ...]] = []

    def add(self, sample: ImuSample, command: Vector) -> bool:
        """Take a sample and the command after it; return whether all is recorded."""
        time_s = 1e-6 * sample.time_us
        if not self._rows or time_s > self._rows[-1][0]:
            self._rows.append((time_s, *sample.gyro_B, *command))
        return time_s - self._rows[0][0] > 3.0 * _AXIS_S

    def split(self) -> tuple[AxisRecord, ...]:
        """Return the measured part of each axis."""
        rows = np.array(self._rows)
        time = rows[:, 0] - rows[0, 0]
        records = []
        for axis in range(3):
            begin = axis * _AXIS_S + _SETTLE_S
            part = (time >= begin) & (time < begin + _MEASURED_S)
            records.append(AxisRecord(time=time[part], command=rows[part, 4 + axis], rate=rows[part, 1 + axis]))
        return tuple(records)


def _excitation() -> References:
    """Return the rates to add on each axis, from sample to sample."""
    count = round((_SETTLE_S + _MEASURED_S) / DT)
    signal_ = np.cos(np.outer(np.arange(count) * DT, OMEGA) + _PHASE) @ _AMPLITUDE
    added: list[tuple[int, Vector]] = []
    for axis in range(3):
        begin_us = round(1e6 * axis * _AXIS_S)
        for k, value in enumerate((*signal_.tolist(), 0.0)):
            p, q, r = (value if axis == each else 0.0 for each in range(3))
            added.append((begin_us + k * round(1e6 * DT), (p, q, r)))
    return added


def _excitation_law() -> Law:
    """Return the law that commands its reference, as a rate, and holds its own attitude estimate near the start."""
    I, O = np.eye(3), np.zeros((3, 3))  # noqa: E741
    return Law(
        name="excitation",
        A=np.block([[I, O], [O, O]]),
        B=np.block([[O, O], [I, O]]),
        C=np.hstack([-_HOLD * I, O]),
        D=np.hstack([O, I]),
        G=np.vstack([DT * I, O]),
        H=np.zeros((6, 3)),
        dt=DT,
        limits=np.full(3, _RATE_LIMIT),
        output=Output.RATES,
        provenance=Provenance(design="identification of the rate loop", vehicle="any"),
    )
