"""Advice on an autopilot's gains, computed from its loop: what a parameter costs, and what another value would allow.

Each parameter is changed by itself and the loop is built again. Then all rate gains of an axis (P, I and D) are scaled
together until the sensitivity peak is the one before. What that brings is the predicted error in the air.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.types import AXES
from gustproof.airframe.covariance import AxisModel, axis_models, open_loop, rms
from gustproof.airframe.hover import loop_law
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.law.form import Law
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix
from gustproof.types import finite_or_none

_FACTORS = np.geomspace(0.125, 4.0, 121)
"""[-] scales of the rate gains that are tried, 3 % apart."""
_CHANGES = (0.5, 0.7, 1.4, 2.0, 3.0)
"""[-] changes of a gain or of a filter's corner that are tried."""
TARGET = 2.0
"""[-] sensitivity peak that the gains of a loop above it, or of an unstable one, are scaled to."""
_WORTH = 0.95
"""[-] share of the error at the same sensitivity peak below which a change is worth telling."""
_LEAST_COST = 0.1
"""[deg] least phase that is listed as a filter's cost."""
_MOST = 3
"""Most changes that are listed."""
_POINTS = 300


class GainFamily(NamedTuple):
    """Parameters that do the same for some axes, and take the same change."""

    label: str
    """Function in words."""
    names: tuple[str, ...]
    """Names."""
    axes: tuple[int, ...]
    """Axes that they act on: 0, 1, 2 for roll, pitch, yaw."""
    unit: str = ""
    """Unit of a filter's corner, which 0 switches off; empty for a gain."""


_TILT, _YAW, _ALL = (0, 1), (2,), (0, 1, 2)
_SCALES = (GainFamily("roll and pitch", (), _TILT), GainFamily("yaw", (), _YAW))
FAMILIES: Mapping[str, tuple[GainFamily, ...]] = {
    "px4": (
        GainFamily("gyro filter", ("IMU_GYRO_CUTOFF",), _ALL, "Hz"),
        GainFamily("D filter", ("IMU_DGYRO_CUTOFF",), _ALL, "Hz"),
        GainFamily("notches", ("IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF1_FRQ"), _ALL, "Hz"),
        GainFamily("yaw torque filter", ("MC_YAW_TQ_CUTOFF",), _YAW, "Hz"),
        GainFamily("rate P", ("MC_ROLLRATE_P", "MC_PITCHRATE_P"), _TILT),
        GainFamily("rate P", ("MC_YAWRATE_P",), _YAW),
        GainFamily("rate I", ("MC_ROLLRATE_I", "MC_PITCHRATE_I"), _TILT),
        GainFamily("rate I", ("MC_YAWRATE_I",), _YAW),
        GainFamily("rate D", ("MC_ROLLRATE_D", "MC_PITCHRATE_D"), _TILT),
        GainFamily("rate D", ("MC_YAWRATE_D",), _YAW),
        GainFamily("angle P", ("MC_ROLL_P", "MC_PITCH_P"), _TILT),
        GainFamily("angle P", ("MC_YAW_P",), _YAW),
    ),
    "ardupilot": (
        GainFamily("gyro filter", ("INS_GYRO_FILTER",), _ALL, "Hz"),
        GainFamily("D filter", ("ATC_RAT_RLL_FLTD", "ATC_RAT_PIT_FLTD"), _TILT, "Hz"),
        GainFamily("D filter", ("ATC_RAT_YAW_FLTD",), _YAW, "Hz"),
        GainFamily("target filter", ("ATC_RAT_RLL_FLTT", "ATC_RAT_PIT_FLTT"), _TILT, "Hz"),
        GainFamily("target filter", ("ATC_RAT_YAW_FLTT",), _YAW, "Hz"),
        GainFamily("error filter", ("ATC_RAT_RLL_FLTE", "ATC_RAT_PIT_FLTE"), _TILT, "Hz"),
        GainFamily("error filter", ("ATC_RAT_YAW_FLTE",), _YAW, "Hz"),
        GainFamily("rate P", ("ATC_RAT_RLL_P", "ATC_RAT_PIT_P"), _TILT),
        GainFamily("rate P", ("ATC_RAT_YAW_P",), _YAW),
        GainFamily("rate I", ("ATC_RAT_RLL_I", "ATC_RAT_PIT_I"), _TILT),
        GainFamily("rate I", ("ATC_RAT_YAW_I",), _YAW),
        GainFamily("rate D", ("ATC_RAT_RLL_D", "ATC_RAT_PIT_D"), _TILT),
        GainFamily("rate D", ("ATC_RAT_YAW_D",), _YAW),
        GainFamily("angle P", ("ATC_ANG_RLL_P", "ATC_ANG_PIT_P"), _TILT),
        GainFamily("angle P", ("ATC_ANG_YAW_P",), _YAW),
    ),
}
"""Parameters that advice is about, by autopilot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """Change of one family of parameters, and what it brings once the rate gains are scaled to the same Ms."""

    family: GainFamily
    """Changed parameters; without names, the rate gains of its axes alone are scaled."""
    changes: dict[str, tuple[float, float]]
    """Value and proposed value by name."""
    phase: tuple[float, float] | None
    """Phase [deg] that the filter costs, at the crossover [rad/s] where it costs most; `None` for a gain."""
    gains: dict[str, float]
    """[-] scale of the rate gains P, I, D by axis."""
    Ms: dict[str, float]
    """[-] sensitivity peak by axis after that: the one before, or 2 where it was larger and can be reached."""
    rmse_deg: tuple[float | None, float]
    """[deg] predicted error of the three axes before and after; `None` for an unstable loop."""
    slew: tuple[float | None, float]
    """[N*m/s] predicted torque slew likewise."""
    open_axes: int
    """Number of axes with a sensitivity peak that is still above 2."""

    def describe(self) -> str:
        """Return the advice in a line or two."""
        scaled = ", ".join(f"{axis} {gain:.2g} times (Ms {self.Ms[axis]:.3g})" for axis, gain in self.gains.items())
        before = [_number(pair[0]) for pair in (self.rmse_deg, self.slew)]
        error, slew = f"{before[0]} to {self.rmse_deg[1]:.3g} deg", f"{before[1]} to {self.slew[1]:.3g} N m/s"
        brings = f"rate P, I, D {scaled}: error {error}, slew {slew}"
        if not self.changes:
            return brings
        unit = f" {self.family.unit}" if self.family.unit else ""
        values = [f"{name} {old:.3g}{unit} to {_value(new, unit)}" for name, (old, new) in self.changes.items()]
        cost = ""
        if self.phase is not None and self.phase[0] >= _LEAST_COST:
            cost = f" (costs {self.phase[0]:.2g} deg of phase at {self.phase[1]:.3g} rad/s)"
        return f"{self.family.label}{cost}: {', '.join(values)} allows {brings}"


class _Axis(NamedTuple):
    """Loop of one axis, and its figures over scales of the rate gains."""

    model: AxisModel
    controller: Lti
    L: ComplexMatrix
    peaks: Matrix  # [-] sensitivity peak at each of `_FACTORS`; infinite where it is unstable

    def scale(self, target: float) -> int | None:
        """Return the index of the largest scale up to which the peak stays within `target`, or the nearest one."""
        good = np.flatnonzero(self.peaks <= target)
        if not good.size:
            return None
        start = int(good[np.argmin(np.abs(good - _AS_IS))])
        beyond = np.flatnonzero(self.peaks[start:] > target)
        return start + int(beyond[0]) - 1 if beyond.size else len(self.peaks) - 1

    def performance(self, index: int) -> tuple[float, float]:
        """Return rms attitude [rad] and slew [N*m/s] with the rate gains scaled; infinite for an unstable loop."""
        if not math.isfinite(self.peaks[index]):
            return math.inf, math.inf
        K, k = self.controller, _FACTORS[index]
        return rms(self.model, Lti(A=K.A, B=K.B, C=k * K.C, D=k * K.D, dt=K.dt))


_AS_IS = int(np.argmin(np.abs(np.log(_FACTORS))))


def advise(law: Law, vehicle: Vehicle, scenario: Scenario, *, slew: float) -> tuple[Advice, ...]:
    """Return the changes of an autopilot's parameters that matter most, the best first; empty for another law.

    Scales of the rate gains alone come first; the others bring at least 5 % less error than those, or a sensitivity
    peak within 2. None has more predicted torque slew than `slew` [N*m/s].

    Raises
    ------
    ValueError
        If the scenario has no turbulence.
    """
    kind = autopilot_kind(law)
    return () if kind is None else _Advisor(kind, law.provenance.parameters, vehicle, scenario).advise(slew)


def autopilot_kind(law: Law) -> str | None:
    """Return the autopilot whose loops the law is, by the names of its parameters; `None` for another law."""
    return next((kind for kind in FAMILIES if FAMILIES[kind][0].names[0] in law.provenance.parameters), None)


class _Advisor:
    """One autopilot's loops on a vehicle in the air, and what they become with other parameters."""

    def __init__(self, kind: str, parameters: Mapping[str, float], vehicle: Vehicle, scenario: Scenario) -> None:
        self._kind, self._parameters, self._vehicle = kind, dict(parameters), vehicle
        self._rate, self._models = scenario.control_rate_hz, axis_models(vehicle, scenario)
        self._omega = np.geomspace(0.1, 0.999 * math.pi / scenario.dt, _POINTS)
        self._now = self._axes({})
        peaks = [float(axis.peaks[_AS_IS]) for axis in self._now]
        self._open = [axis for axis, peak in enumerate(peaks) if peak > TARGET]
        self._targets = [min(peak, TARGET) for peak in peaks]
        self._as_is = [axis.performance(_AS_IS) for axis in self._now]
        self._before = _pool(self._as_is)
        self._phase_cost = cache(self._find_phase_cost)

    def advise(self, slew: float) -> tuple[Advice, ...]:
        alone = [found for family in _SCALES if (found := self._assess(family, {}, slew))]
        alone = [each for each in alone if any(abs(gain - 1.0) > 1.0 - _WORTH for gain in each.gains.values())]
        usual = min([(len(self._open), self._before[0]), *map(_rank, alone)])
        best = []
        for family in FAMILIES[self._kind]:
            tried = (self._assess(family, change, slew) for change in self._changes(family))
            best += sorted((each for each in tried if each is not None), key=_rank)[:1]
        worth = [each for each in best if _rank(each) < (usual[0], _WORTH * usual[1])]
        return (*alone, *sorted(worth, key=_rank)[:_MOST])

    def _changes(self, family: GainFamily) -> Iterator[dict[str, float]]:
        """Yield new values of a family within their ranges; filters are also switched off, nothing is switched on."""
        values = {name: self._parameters[name] for name in family.names if self._parameters[name]}
        ranges, whole = AUTOPILOTS[self._kind].settings, AUTOPILOTS[self._kind].whole
        for factor in (*_CHANGES, *([0.0] if family.unit else [])):
            tried = {name: factor * value for name, value in values.items()}
            changed = {name: float(round(value)) if name in whole else value for name, value in tried.items()}
            if changed and all(ranges[name].low <= value <= ranges[name].high for name, value in changed.items()):
                yield changed

    def _axes(self, changes: Mapping[str, float], axes: Sequence[int] = _ALL) -> list[_Axis]:
        """Return the loops with other values; those of other axes than `axes` are as they were."""
        law = autopilot_law(self._kind, {**self._parameters, **changes}, self._vehicle, rate_hz=self._rate).law
        return [
            _axis(law, axis, model, self._omega) if axis in axes else self._now[axis]
            for axis, model in enumerate(self._models)
        ]

    def _assess(self, family: GainFamily, changes: Mapping[str, float], most: float) -> Advice | None:
        """Return what a change brings with the rate gains of the family's axes scaled to the targets.

        It is `None` if an axis cannot be brought to its target, a loop is unstable, or the slew is above `most`.
        """
        axes = self._axes(changes, family.axes) if changes else self._now
        scales = dict[int, int]()
        for axis in family.axes:
            index = axes[axis].scale(self._targets[axis])
            if index is None:
                return None
            scales[axis] = index
        figures = list(self._as_is)
        for axis, index in scales.items():
            figures[axis] = axes[axis].performance(index)
        rmse, slew = _pool(figures)
        if not math.isfinite(rmse) or slew > most:
            return None
        return Advice(
            family=family,
            changes={name: (self._parameters[name], value) for name, value in changes.items()},
            phase=self._phase_cost(family) if family.unit else None,
            gains={AXES[axis]: float(_FACTORS[scales[axis]]) for axis in family.axes},
            Ms={AXES[axis]: float(axes[axis].peaks[scales[axis]]) for axis in family.axes},
            rmse_deg=(finite_or_none(self._before[0]), rmse),
            slew=(finite_or_none(self._before[1]), slew),
            open_axes=len({*self._open} - {*family.axes}),
        )

    def _find_phase_cost(self, family: GainFamily) -> tuple[float, float]:
        """Return the largest phase [deg] that filters cost an axis at its crossover [rad/s]."""
        without = self._axes(dict.fromkeys(family.names, 0.0), family.axes)
        costs = []
        for axis in family.axes:
            L = self._now[axis].L
            at = max(np.flatnonzero(np.abs(L) >= 1.0), default=0)
            costs.append((math.degrees(float(np.angle(without[axis].L[at] / L[at]))), float(self._omega[at])))
        return max(costs)


def _axis(law: Law, axis: int, model: AxisModel, omega: Matrix) -> _Axis:
    controller = loop_law(law).subsystem([axis], [axis]).drop_unconnected()
    loop = open_loop(model, controller)
    L = loop.response(omega)[:, 0, 0]
    closed = loop.A - _FACTORS[:, None, None] * (loop.B @ loop.C)
    stable = np.max(np.abs(np.linalg.eigvals(closed)), axis=1) < 1.0
    peaks = 1.0 / np.min(np.abs(1.0 + _FACTORS[:, None] * L), axis=1)
    return _Axis(model, controller, L, np.where(stable, peaks, math.inf))


def _pool(axes: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return error [deg] and slew [N*m/s] of all axes."""
    rmse, slew = np.sqrt(np.mean(np.square(axes), axis=0)).tolist()
    return math.degrees(rmse), slew


def _rank(advice: Advice) -> tuple[int, float]:
    return advice.open_axes, advice.rmse_deg[1]


def _number(value: float | None) -> str:
    return "(unstable)" if value is None else f"{value:.3g}"


def _value(value: float, unit: str) -> str:
    return f"{value:.3g}{unit}" if value or not unit else "off"
