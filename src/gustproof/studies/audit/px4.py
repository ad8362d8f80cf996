"""PX4's own simulator, SIH, audited through PX4's test of its motors.

Each flight climbs from the ground on equal rotors and coasts to a level hover: SIH begins in no other state. Unequal
rotors settle within a step there (`SIH_T_TAU`). A pulse of the rotors begins a spin, after which it is not level. Its
steps are Euler's: it takes several in a step of the audit, as the error of one is seen beside its large drag.
Versions of 2026 have a steady wind, from the first step on: it carries the vehicle before the audit looks.
"""

from functools import cached_property
from pathlib import Path

import numpy as np

from firmware_model.errors import ConfigError
from firmware_model.external.px4_process import find_build
from gustproof.studies.audit.px4_flight import ROTORS, AuditPhase, Record, record_flight
from gustproof.studies.audit.simulator import (
    STILL,
    Airframe,
    Array,
    FlightStart,
    NotReachable,
    RequestedAir,
    Simulator,
    TrueMotion,
    to_vector,
)

_CLIMB, _CLIMB_S, _COAST_S = 1.2, 1.0, 7.0  # [-] of the hover commands; its drag takes a second
_PULSES_S = (0.25, 0.26)  # shortest and longest: the weakest axis, yaw, reaches 1 rad/s
_SPARE_S = 0.3  # the log's last block is not written
_ATTEMPTS = 8
_FAST = 10.0  # times real time, halved every second attempt: on a busy machine commands come late
_IN_THE_AIR = 0.1  # [m] on the ground SIH holds the vehicle still, at any thrust
_STEP_US = 1000
_RESOLUTION = 0.001  # [-] of a command
_REST = 0.01  # [m/s]
_LEVEL, _SPIN = 1e-3, 0.01  # [rad] or [rad/s]; [rad/s] error of a spin
_NO_WIND, _NO_GUSTS = "SIH has no such wind", "SIH has no turbulence"
_WINDS = ("SIH_WIND_N", "SIH_WIND_E")  # [m/s] of the wind from north and east


class Px4Sih(Simulator):
    """SIH's quadrotor, with its own parameters."""

    name = "PX4's quadrotor (SIH)"

    def __init__(self, build: Path | None) -> None:
        self._build = find_build(build)

    @cached_property
    def _values(self) -> dict[str, float]:
        return record_flight(self._build, {}, [AuditPhase(np.zeros(ROTORS), _SPARE_S)], _FAST).parameters

    @cached_property
    def airframe(self) -> Airframe:
        """Vehicle of SIH's parameters; which rotor is where and turns how is as PX4's mixer has it."""
        try:
            return _airframe(self._values)
        except KeyError as missing:
            raise ConfigError(f"audit px4: PX4 has no parameter {missing}") from None

    def fly(
        self, seed: int, dt: float, air: RequestedAir, start: FlightStart, rotors: Array, duration: float
    ) -> list[TrueMotion]:
        """Fly once, or again while a flight did not begin as asked."""
        hover, spin = self.airframe.hover(), np.array(start.omega_B)
        rate = f"{1_000_000 // _STEP_US}"
        parameters = {"IMU_INTEG_RATE": rate, "IMU_GYRO_RATEMAX": rate, **self._wind(air)}  # SIH steps at the lesser
        if np.array_equal(start.rotors, rotors):
            parameters["SIH_T_TAU"] = f"{1e-6 * _STEP_US:g}"
        elif not np.array_equal(start.rotors, hover):
            raise NotReachable("rotors settle in flight only, where unequal ones turn it")
        before, allowed, coast_s, speed = hover, _LEVEL, _COAST_S, _FAST
        if spin.any():  # it need not be at rest, but the commands must be there before drag has slowed the spin
            before, allowed, coast_s, speed = np.zeros(ROTORS), _SPIN, 0.0, 1.0
        impulse = spin
        for attempt in range(_ATTEMPTS):
            last = [self._pulse(impulse)] * bool(spin.any()) + [AuditPhase(rotors, duration + _SPARE_S)]
            phases = [AuditPhase(_CLIMB * hover, _CLIMB_S), AuditPhase(hover, coast_s), *last]
            record = record_flight(self._build, parameters, phases, min(speed, _FAST / 2 ** (attempt // 2)))
            motions = _cut(record, before, rotors, np.arange(0.0, duration + 0.5 * dt, dt))
            if not motions:
                continue
            reached = np.array(motions[0].omega_B)
            is_free = air != STILL or spin.any()
            if np.abs(spin - reached).max() < allowed and (is_free or _is_at_rest(motions[0])):
                return motions
            # In proportion, since the rotors may turn it by another factor than stated, or the other way.
            has_turned = np.abs(reached) > 0.2 * np.abs(spin)
            impulse = impulse * np.divide(spin, reached, out=np.ones(3), where=has_turned)
        raise NotReachable(f"none of {_ATTEMPTS} flights began as asked")

    def sample_air(self, seed: int, dt: float, air: RequestedAir, samples: int) -> Array:
        """Refuse: there is none to sample."""
        raise NotReachable(_NO_GUSTS)

    def level_flight(self, seed: int, dt: float, air: RequestedAir, duration: float) -> tuple[float, list[TrueMotion]]:
        """Refuse: it is for turbulence alone."""
        raise NotReachable(_NO_GUSTS)

    def _wind(self, air: RequestedAir) -> dict[str, str]:
        """Return the parameters of a steady wind."""
        if air.turbulence is not None:
            raise NotReachable(_NO_GUSTS)
        *level, down = air.wind_N
        if down or (air != STILL and not set(_WINDS) <= self._values.keys()):
            raise NotReachable(_NO_WIND)
        return {name: f"{-speed:g}" for name, speed in zip(_WINDS, level, strict=True) if speed}

    def _pulse(self, impulse: Array) -> AuditPhase:
        """Return the pulse that changes the rates by an impulse (3,) [rad/s] B, the one that rounding changes least."""
        airframe = self.airframe
        hover, inertia = airframe.hover(), np.array(airframe.inertia_B)
        pulses = []
        for duration in np.arange(*_PULSES_S, 1e-3):
            change = np.linalg.pinv(airframe.wrench)[:, :3] @ (inertia * impulse / duration) / airframe.thrust_max
            rounding = airframe.wrench[:3] @ ((hover + change).round(3) - hover - change) / inertia
            pulses.append((float(np.abs(rounding).max()) * duration, duration, hover + change))
        _, duration, rotors = min(pulses, key=lambda pulse: pulse[0])
        return AuditPhase(rotors, float(duration), is_pulse=True)


def _airframe(values: dict[str, float]) -> Airframe:
    x, y = values["SIH_L_PITCH"], values["SIH_L_ROLL"]
    signs = np.sign([[values[f"CA_ROTOR{i}_{name}"] for name in ("PX", "PY", "KM")] for i in range(ROTORS)])
    return Airframe(
        mass=values["SIH_MASS"],
        inertia_B=to_vector([values[f"SIH_I{axis}"] for axis in ("XX", "YY", "ZZ")]),
        position_B=tuple(to_vector((x * right_x, y * right_y, 0.0)) for right_x, right_y, _ in signs),
        spin=tuple(int(sign) for sign in signs[:, 2]),
        drag_ratio=values["SIH_Q_MAX"] / values["SIH_T_MAX"],
        thrust_max=values["SIH_T_MAX"],
        thrust_square=0.0,
        actuator_lag=values["SIH_T_TAU"],
    )


def _cut(record: Record, before: Array, rotors: Array, times: Array) -> list[TrueMotion]:
    """Return the motions at times [s] from the step on at which the last commands act.

    None if a command is not as asked, a step is missing, or the vehicle is on the ground.
    """
    others = np.flatnonzero(np.abs(record.rotors - rotors).max(axis=1) >= _RESOLUTION)
    begin = max([int(np.searchsorted(record.time_us, record.sent_us)), *(others[-1:] + 1)])
    if not 0 < begin < len(record.time_us) or np.abs(record.rotors[begin - 1] - before).max() >= _RESOLUTION:
        return []
    wanted_us = record.time_us[begin] + np.rint(1e6 * times).astype(np.int64)
    if not np.isin([wanted_us[0] - _STEP_US, *wanted_us], record.time_us).all():
        return []
    rows = np.searchsorted(record.time_us, wanted_us)
    if record.height[rows].min() < _IN_THE_AIR:
        return []
    columns = (record.velocity_N[rows].tolist(), record.q_NB[rows].tolist(), record.omega_B[rows].tolist())
    return [TrueMotion(tuple(v), tuple(q), tuple(omega)) for v, q, omega in zip(*columns, strict=True)]


def _is_at_rest(motion: TrueMotion) -> bool:
    return max(map(abs, motion.velocity_N)) < _REST and max(map(abs, motion.q_NB[1:])) < _LEVEL
