"""Real autopilots, laws and controllers side by side: the same scenarios, vehicle and seeds, each in its own loops.

Each is compared with the first, seed by seed, until it is known to be better, worse or alike.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from statistics import geometric_mean, median
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.design.inside import PriceInside
from gustproof.errors import DesignError
from gustproof.flight.controllers.external_autopilot import AnyController, ExternalAutopilot
from gustproof.flight.routes.controllers import fly_controller, fly_to_end
from gustproof.flight.routes.flight import Flight
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.upsets import first_tilt_s
from gustproof.flight.scoring.estimator_view import EstimatorView, steady_rmse_deg
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.flight.scoring.phases import FlightPhase, PhaseFigures, find_phases, measure_phases
from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.studies.campaign.paired import Change, error_ratio, find_change, mean_change
from gustproof.studies.operating_point import MeasuredPoint, measure_operating_point
from gustproof.types import Records, finite_or_none

WORST_DEG = 60.0
"""[deg] error that counts for a failed flight, and the largest that counts for any."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseRow:
    """Medians over the seeds of one controller in a phase of a scenario, and its changes from the first, paired.

    They describe: each interval holds for itself, and the verdict is that of the whole flight.
    """

    scenario: str
    """Scenario."""
    name: str
    """Name of the phase: all that begins or lasts in it, or all that ended; `before` if nothing has happened yet."""
    duration_s: float
    """[s] of all its parts."""
    rmse_deg: float
    """[deg] rms of the true attitude error, with the median of each axis over the whole flight removed."""
    peak_deg: float
    """[deg] largest magnitude of that error."""
    torque_slew_rms: float | None
    """[N*m/s] rms of the commanded torque's change; `None` if the phase was not flown."""
    saturated_s: float | None
    """[s] time with a commanded torque at the vehicle's limit, likewise."""
    rmse_ratio: IntervalEstimate | None
    """[-] `rmse_deg` over that of the first, geometric mean; `None` for the first, or if one is 0."""
    peak_ratio: IntervalEstimate | None
    """[-] `peak_deg` over that of the first, likewise."""
    slew_ratio: IntervalEstimate | None
    """[-] `torque_slew_rms` over that of the first, likewise, of seeds in which both flew the phase."""
    saturated_more_s: IntervalEstimate | None
    """[s] `saturated_s` less that of the first, mean, of seeds in which both flew the phase."""

    def to_dict(self) -> dict[str, Any]:
        """Return the phase as JSON values."""
        return {
            "scenario": self.scenario,
            "name": self.name,
            "duration_s": self.duration_s,
            "rmse_deg": self.rmse_deg,
            "peak_deg": self.peak_deg,
            "torque_slew_rms": self.torque_slew_rms,
            "saturated_s": self.saturated_s,
            "rmse_ratio": _to_json(self.rmse_ratio),
            "peak_ratio": _to_json(self.peak_ratio),
            "slew_ratio": _to_json(self.slew_ratio),
            "saturated_more_s": _to_json(self.saturated_more_s),
        }


def _to_json(interval: IntervalEstimate | None) -> dict[str, float | None] | None:
    return None if interval is None else {name: finite_or_none(end) for name, end in interval._asdict().items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonRow:
    """Medians over the seeds of one controller, of geometric means over the scenarios; angles over three axes."""

    name: str
    """Controller."""
    steady_rmse_deg: float
    """[deg] rms of the true attitude error with each axis' mean removed."""
    rmse_deg: float
    """[deg] rms of the true attitude; it holds the heading error of an autopilot's compass."""
    own_rmse_deg: float | None
    """[deg] rms of the error that an autopilot sees itself; `None` for what flies here."""
    predicted_own_rmse_deg: float | None
    """[deg] the same by the model, of an autopilot's own loops or of a law inside; `None` if the model has none."""
    torque_slew_rms: float
    """[N*m/s] rms of the commanded torque's change."""
    predicted_slew: float | None
    """[N*m/s] the same by the model."""
    Ms: float | None
    """[-] largest sensitivity peak of an axis, measured in flights here, by the model of an autopilot; or `None`."""
    delay_margin_s: float | None
    """[s] least destabilising additional delay, likewise."""
    realtime_factor: float | None
    """[-] simulated time over wall time; `None` for what flies here."""
    seeds: int
    """Number of seeds, each flown in all scenarios."""
    failed: int
    """Number of flights that broke off, diverged or tilted past 90 deg, and count as `WORST_DEG`."""
    ratio: IntervalEstimate | None
    """[-] `steady_rmse_deg` over that of the first controller in the same seeds; `None` for the first."""
    own_ratio: IntervalEstimate | None
    """[-] `own_rmse_deg` likewise; `None` for the first, and beside what has no estimate of its own."""
    by_scenario: dict[str, float]
    """[-] the same in each scenario, if there are several; [deg] for the first its error."""
    phases: tuple[PhaseRow, ...]
    """Figures by phase of each scenario, cut by what happens in part of it; they decide no verdict."""

    @property
    def change(self) -> Change | None:
        """Verdict beside the first controller; `None` for the first."""
        return None if self.ratio is None else find_change(self.ratio)

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON values."""
        value, low, high = self.ratio or (None, None, None)
        own, own_low, own_high = self.own_ratio or (None, None, None)
        return {
            "name": self.name,
            "steady_rmse_deg": self.steady_rmse_deg,
            "rmse_deg": self.rmse_deg,
            "own_rmse_deg": self.own_rmse_deg,
            "predicted_own_rmse_deg": self.predicted_own_rmse_deg,
            "torque_slew_rms": self.torque_slew_rms,
            "predicted_slew": self.predicted_slew,
            "Ms": self.Ms,
            "delay_margin_s": self.delay_margin_s,
            "realtime_factor": self.realtime_factor,
            "seeds": self.seeds,
            "failed": self.failed,
            "by_scenario": self.by_scenario,
            "phases": [each.to_dict() for each in self.phases],
            "error_ratio": value,
            "error_ratio_low": low,
            "error_ratio_high": None if high == math.inf else high,
            "own_error_ratio": own,
            "own_error_ratio_low": own_low,
            "own_error_ratio_high": None if own_high == math.inf else own_high,
            "verdict": None if self.change is None else self.change.value,
        }


def compare(
    scenarios: Sequence[Scenario],
    vehicle: Vehicle,
    controllers: Mapping[str, AnyController],
    seeds: Sequence[int],
    progress: Callable[[float, str], None] = lambda *_: None,
    predicted: Mapping[str, PriceInside] = MappingProxyType({}),
) -> list[ComparisonRow]:
    """Fly controllers, by their names, with the same seeds and return the row of each; autopilots leave no files.

    A controller flies on, seed by seed, until its error over that of the first is known, see `find_change`. Its error
    with a seed is the geometric mean over the scenarios. What the model `predicted` of some stands in their rows.

    Raises
    ------
    ConfigError
        If a controller can't be started as requested.
    FlightError
        If a flight of a real autopilot ends before the scenario does.
    """
    flown: dict[str, _Flights] = {name: [] for name in controllers}
    still = list(controllers)
    first = flown[still[0]]
    for j, seed in enumerate(seeds):
        for place, name in enumerate(still):
            progress((j + place / len(still)) / len(seeds), f"{name}, seed {seed}")
            flown[name].append([_fly(each, vehicle, controllers[name], seed) for each in scenarios])
        still[1:] = [each for each in still[1:] if find_change(_ratio(flown[each], first)) is Change.OPEN]
        if len(still) == 1 < len(controllers):
            break
    return [
        _make_row(
            name,
            each,
            None if each is first else first,
            scenarios,
            _measure_point(controllers[name], vehicle, scenarios[0]),
            predicted.get(name),
        )
        for name, each in flown.items()
    ]


class _Flown(NamedTuple):
    """Figures of one flight, as of `ComparisonRow`."""

    steady_rmse_deg: float  # [deg]
    rmse_deg: float  # [deg]
    own_rmse_deg: float | None  # [deg]
    torque_slew_rms: float  # [N*m/s]
    realtime_factor: float | None  # [-]
    failed: bool
    phases: tuple[PhaseFigures | None, ...] = ()  # of the scenario


_Flights = list[list[_Flown]]  # seeds, scenarios
_PhaseFlights = Sequence[PhaseFigures | None]  # seeds


def _errors(flown: _Flights) -> list[float]:
    return [geometric_mean(each.steady_rmse_deg for each in seed) for seed in flown]


def _ratio(flown: _Flights, first: _Flights) -> IntervalEstimate:
    return error_ratio(_errors(flown), _errors(first[: len(flown)]))


def _own_errors(flown: _Flights) -> list[float] | None:
    """Return the error [deg] by an autopilot's own estimate with each seed; `None` if a flight has none."""
    found = [[each.own_rmse_deg for each in seed] for seed in flown]
    if any(each is None for seed in found for each in seed):
        return None
    return [geometric_mean(each for each in seed if each is not None) for seed in found]


def _own_ratio(flown: _Flights, first: _Flights) -> IntervalEstimate | None:
    errors, others = _own_errors(flown), _own_errors(first[: len(flown)])
    return None if errors is None or others is None else error_ratio(errors, others)


def _fly(scenario: Scenario, vehicle: Vehicle, controller: AnyController, seed: int) -> _Flown:
    if isinstance(controller, ExternalAutopilot):
        flight, figures = fly_to_end(scenario, controller, vehicle, seed)
        return _read_flight(flight, figures, flight.estimator_view, find_phases(scenario))
    with np.errstate(all="ignore"):  # a loop that diverges is a result
        flight = fly_controller(scenario, controller, vehicle=vehicle, seed=seed)
        figures = measure(flight.records, vehicle, scenario, law=controller)
        return _read_flight(flight, figures, None, find_phases(scenario))


def _read_flight(
    flight: Flight, figures: Metrics, view: EstimatorView | None, phases: Sequence[FlightPhase] = ()
) -> _Flown:
    error, rmse = _steady_error(flight.records, flight.scenario), figures.rmse_deg
    tilted_s = first_tilt_s(flight.records)
    failed = flight.outcome is not FlightOutcome.DONE or tilted_s is not None or not error < WORST_DEG
    until_s = math.inf if tilted_s is None else tilted_s
    return _Flown(
        steady_rmse_deg=WORST_DEG if failed else error,
        rmse_deg=_cap(rmse),
        own_rmse_deg=None if view is None else view.control_rmse_deg,
        torque_slew_rms=figures.torque_slew_rms,
        realtime_factor=figures.realtime_factor or None,
        failed=failed,
        phases=measure_phases(flight.records, flight.scenario, flight.vehicle, phases, until_s, law=flight.law)
        if phases
        else (),
    )


def _steady_error(records: Records, scenario: Scenario) -> float:
    return steady_rmse_deg(records, scenario.references) if len(records) else math.inf


def _measure_point(controller: AnyController, vehicle: Vehicle, scenario: Scenario) -> MeasuredPoint | None:
    """Return the operating point of what flies here, by flights in calm air; `None` if it can't be measured."""
    if not isinstance(controller, ExternalAutopilot):
        with suppress(DesignError, ValueError, np.linalg.LinAlgError), np.errstate(all="ignore"):
            return measure_operating_point(controller, vehicle, scenario, seeds=())
    return None


def _make_row(
    name: str,
    flown: _Flights,
    first: _Flights | None,
    scenarios: Sequence[Scenario],
    point: MeasuredPoint | None,
    predicted: PriceInside | None = None,
) -> ComparisonRow:
    """Return the row of a controller; `first` are the flights that it is compared with."""
    margin = math.inf if point is None else point.delay_margin
    error, slew, Ms = _forecast(predicted)
    ratio, own_ratio = (None, None) if first is None else (_ratio(flown, first), _own_ratio(flown, first))
    return ComparisonRow(
        name=name,
        steady_rmse_deg=median(_errors(flown)),
        rmse_deg=median(geometric_mean(each.rmse_deg for each in seed) for seed in flown),
        own_rmse_deg=_middle(flown, "own_rmse_deg"),
        predicted_own_rmse_deg=error,
        torque_slew_rms=median(geometric_mean(each.torque_slew_rms for each in seed) for seed in flown),
        predicted_slew=slew,
        Ms=Ms if point is None else point.Ms,
        delay_margin_s=margin if math.isfinite(margin) else None,
        realtime_factor=_middle(flown, "realtime_factor"),
        seeds=len(flown),
        failed=sum(each.failed for seed in flown for each in seed),
        ratio=ratio,
        own_ratio=own_ratio,
        by_scenario=dict(_by_scenario(flown, first, scenarios)),
        phases=tuple(_by_phase(flown, first, scenarios)),
    )


def _forecast(predicted: PriceInside | None) -> tuple[float, float, float] | tuple[None, None, None]:
    """Return error [deg], slew [N*m/s] and Ms [-] by the model; `None` for each if it has none."""
    if predicted is None:
        return None, None, None
    return math.degrees(predicted.seen_rmse), predicted.slew, predicted.Ms


def _middle(flown: _Flights, figure: str) -> float | None:
    """Return the median of a figure over all flights; `None` if none has it."""
    return _find_median([value for seed in flown for each in seed if (value := getattr(each, figure)) is not None])


def _find_median(found: Sequence[float]) -> float | None:
    return median(found) if found else None


def _by_scenario(flown: _Flights, first: _Flights | None, scenarios: Sequence[Scenario]) -> Iterator[tuple[str, float]]:
    """Yield each of several scenarios with the error in it [deg], or over that of `first`."""
    for k, scenario in enumerate(scenarios if len(scenarios) > 1 else ()):
        mine, its = (
            geometric_mean(seed[k].steady_rmse_deg for seed in each) for each in (flown, (first or flown)[: len(flown)])
        )
        yield scenario.name, mine if first is None else mine / its


def _by_phase(flown: _Flights, first: _Flights | None, scenarios: Sequence[Scenario]) -> Iterator[PhaseRow]:
    """Yield each phase of each scenario, with the changes from `first`."""
    for k, scenario in enumerate(scenarios):
        for j, phase in enumerate(find_phases(scenario)):
            mine = [seed[k].phases[j] for seed in flown]
            others = [seed[k].phases[j] for seed in (first or ())[: len(flown)]]
            yield _make_phase(scenario.name, phase, mine, others)


def _make_phase(scenario: str, phase: FlightPhase, mine: _PhaseFlights, others: _PhaseFlights) -> PhaseRow:
    """Return the row of a phase; `others` are the figures of the first in the same seeds, none for the first itself."""
    both = [(each, its) for each, its in zip(mine, others, strict=False) if each is not None and its is not None]
    rmse, its_rmse, peak, its_peak = (
        [_cap(math.inf if each is None else getattr(each, figure)) for each in seeds]
        for figure in ("rmse_deg", "peak_deg")
        for seeds in (mine, others)
    )
    return PhaseRow(
        scenario=scenario,
        name=phase.name,
        duration_s=phase.duration_s,
        rmse_deg=median(rmse),
        peak_deg=median(peak),
        torque_slew_rms=_find_median([each.torque_slew_rms for each in mine if each is not None]),
        saturated_s=_find_median([each.saturated_s for each in mine if each is not None]),
        rmse_ratio=_find_ratio([*zip(rmse, its_rmse, strict=False)]),
        peak_ratio=_find_ratio([*zip(peak, its_peak, strict=False)]),
        slew_ratio=_find_ratio([(each.torque_slew_rms, its.torque_slew_rms) for each, its in both]),
        saturated_more_s=_find_difference([each.saturated_s - its.saturated_s for each, its in both]),
    )


def _find_ratio(pairs: Sequence[tuple[float, float]]) -> IntervalEstimate | None:
    """Return the ratio of figures in pairs; `None` without a pair, or if a figure is 0."""
    return error_ratio(*zip(*pairs, strict=True)) if pairs and all(map(all, pairs)) else None


def _find_difference(differences: Sequence[float]) -> IntervalEstimate | None:
    """Return the mean of differences; `None` without one."""
    return mean_change(np.array(differences)) if differences else None


def _cap(error: float) -> float:
    """Return an error [deg], at most that of a failed flight."""
    return error if error < WORST_DEG else WORST_DEG
