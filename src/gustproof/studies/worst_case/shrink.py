"""Shrink a disturbance that a search found to the least that still turns the vehicle as far as asked.

What the search finds holds much that does no harm: terms, axes, strength, digits, minutes. Each reduction is flown and
kept if the attitude error still reaches the target, within the budget of moments (delta debugging, A. Zeller,
R. Hildebrandt, Simplifying and isolating failure-inducing input, IEEE Transactions on Software Engineering 28, 2002).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import RandomGusts
from firmware_model.types import Vector
from gustproof.flight.controllers.user_controller import Controller
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.scoring.metrics import attitude
from gustproof.studies.worst_case.moment_search import WorstCase, peaks_deg
from gustproof.types import Array

_HALVINGS = 7  # of a strength: to 1 % of it
_DIGITS = (1, 2, 3)
_CUT_S = 0.1  # [s] a flight ends at a multiple of it


@dataclass(frozen=True, slots=True, kw_only=True)
class SmallestCase:
    """The least disturbance found whose flight still reaches a target."""

    scenario: Scenario
    """Script of the flight."""
    vehicle: Vehicle
    """Vehicle of the flight, the nominal one if that suffices."""
    seed: int
    """Seed of the flight; matters only in turbulence."""
    target_deg: float
    """[deg] attitude error that the flight reaches at least."""
    peak_deg: float
    """[deg] its largest attitude error."""
    strength: Vector
    """[-] largest moment about each axis of the vehicle, over that of the flight shrunk; 0 where there was none."""
    terms: int
    """Number of moments of the script."""
    terms_before: int
    """Number of moments of the script that was shrunk."""
    flights: int
    """Number of simulated flights."""


def shrink_case(
    found: WorstCase,
    controller: Controller,
    *,
    vehicle: Vehicle,
    budget: Vector,
    target_deg: float,
    flights: int = 200,
    progress: Callable[[float], None] | None = None,
) -> SmallestCase:
    """Return the smallest flight found, by at most `flights`, that still reaches `target_deg` [deg].

    It tries the nominal `vehicle` in place of a varied one, then fewer moments. Less strength about each axis and about
    all follows, then fewer digits, and an end soon after the target is reached. The result is small by these steps, not
    proved the smallest. Moments stay within `budget` [N*m] B.

    Raises
    ------
    ValueError
        If the flight found does not reach the target.
    """
    if not found.peak_deg >= target_deg:
        raise ValueError(f"the worst flight found reaches {found.peak_deg:.3g} deg, not {target_deg:g} deg")
    return _Shrinking(found, controller, vehicle, budget, target_deg, flights, progress or (lambda _: None)).run()


class _Shrinking:
    """The smallest flight so far, and the count of flights."""

    def __init__(
        self,
        found: WorstCase,
        controller: Controller,
        vehicle: Vehicle,
        budget: Vector,
        target_deg: float,
        flights: int,
        progress: Callable[[float], None],
    ) -> None:
        self._found, self._controller, self._nominal, self._target = found, controller, vehicle, target_deg
        self._budget, self._left, self._flights = np.array(budget), flights, flights
        self._progress = progress
        self._scenario, self._vehicle, self._peak = found.scenario, found.vehicle, found.peak_deg
        self._reached_s, self._moment = math.inf, np.zeros(3)

    def run(self) -> SmallestCase:
        self._try(self._scenario, self._vehicle)  # its moments and the time at which it reaches the target
        before = self._moment
        if self._vehicle != self._nominal:
            self._try(self._scenario, self._nominal)
        self._drop_terms()
        for axes in (*np.eye(3), np.ones(3)):
            self._weaken(axes)
        self._round()
        self._cut()
        strength = np.divide(self._moment, before, out=np.zeros(3), where=before > 0.0)
        L, M, N = strength.tolist()
        description = f"{self._found.scenario.description}, shrunk to {self._target:.3g} deg"
        return SmallestCase(
            scenario=replace(self._scenario, description=description),
            vehicle=self._vehicle,
            seed=self._found.seed,
            target_deg=self._target,
            peak_deg=self._peak,
            strength=(L, M, N),
            terms=len(self._scenario.moment),
            terms_before=len(self._found.scenario.moment),
            flights=self._flights - self._left,
        )

    def _try(self, scenario: Scenario, vehicle: Vehicle) -> bool:
        """Fly a smaller flight; keep it if it reaches the target within the budget of moments, return whether so."""
        if self._left <= 0:
            return False
        self._left -= 1
        self._progress(1.0 - self._left / self._flights)
        seed = self._found.seed
        records = fly_controller(scenario, self._controller, vehicle=vehicle, seed=seed, nominal=self._nominal).records
        peak = max(peaks_deg(records, scenario, vehicle))
        moment = np.max(np.abs(records["moment_B"]), axis=0, initial=0.0)
        if not (peak >= self._target and (moment <= self._budget).all()):
            return False
        beyond = ~(np.abs(np.degrees(attitude(records))).max(axis=1, initial=0.0) < self._target)
        first = int(np.argmax(beyond)) if beyond.any() else len(records)  # else the flight broke off
        self._scenario, self._vehicle, self._peak = scenario, vehicle, peak
        self._reached_s, self._moment = (first + 1) * scenario.dt, moment
        return True

    def _cut(self) -> None:
        """End the flight soon after it reaches the target, without the moments that begin later."""
        end_s = _CUT_S * math.ceil(self._reached_s / _CUT_S + 1e-6)
        if end_s < self._scenario.duration_s:
            began = tuple(term for term in self._scenario.moment if getattr(term, "start_s", 0.0) < end_s)
            self._try(replace(self._scenario, duration_s=round(end_s, 6), moment=began), self._vehicle)

    def _drop_terms(self) -> None:
        """Leave out halves of the moments, quarters, and so on to single ones."""
        size = len(self._scenario.moment)
        while size >= 1:
            at = 0
            while at < len(self._scenario.moment):
                terms = self._scenario.moment
                if not self._try(replace(self._scenario, moment=terms[:at] + terms[at + size :]), self._vehicle):
                    at += size
            size //= 2

    def _weaken(self, axes: Array) -> None:
        """Reduce the strength about the axes marked by 1 in `axes` (3,), by bisection; turbulence if all are."""
        whole, low, high = self._scenario, 0.0, 1.0
        if not self._moment @ axes > 0.0:
            return
        for _ in range(_HALVINGS):
            factor = 0.5 * (low + high)
            scaled = replace(whole, moment=tuple(_scale(term, 1.0 + (factor - 1.0) * axes) for term in whole.moment))
            if axes.all():
                scaled = replace(scaled, wind=tuple(_weaken_wind(item, factor) for item in whole.wind))
            low, high = (low, factor) if self._try(scaled, self._vehicle) else (factor, high)

    def _round(self) -> None:
        for digits in _DIGITS:
            moments = tuple(_round_term(term, digits) for term in self._scenario.moment)
            winds = tuple(_round_term(item, digits) for item in self._scenario.wind)
            if self._try(replace(self._scenario, moment=moments, wind=winds), self._vehicle):
                return


def _scale(term: Any, factors: Array) -> Any:
    amplitudes = (np.array(term.amplitude_nm) * factors + 0.0).tolist()  # 0.0, not -0.0
    return replace(term, amplitude_nm=tuple(amplitudes))


def _weaken_wind(item: Any, factor: float) -> Any:
    if not isinstance(item, RandomGusts) or item.wind_speed_20ft_mps is None:
        return item
    return replace(item, wind_speed_20ft_mps=factor * item.wind_speed_20ft_mps)


def _round_term(term: Any, digits: int) -> Any:
    """Return a moment or turbulence with its numbers rounded to significant digits."""
    changes: dict[str, Any] = {}
    for name, value in _numbers(term):
        rounded = [float(f"{each:.{digits}g}") for each in value]
        changes[name] = tuple(rounded) if len(rounded) > 1 else rounded[0]
    return replace(term, **changes)


def _numbers(term: Any) -> Iterator[tuple[str, Sequence[float]]]:
    """Yield the numbers of a term that a search chose, by name."""
    for name in ("amplitude_nm", "rate_rad_s", "phase_rad", "wind_speed_20ft_mps"):
        value = getattr(term, name, None)
        if value is not None:
            yield name, value if isinstance(value, tuple) else (value,)
