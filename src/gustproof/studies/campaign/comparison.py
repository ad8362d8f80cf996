"""Real autopilots and laws side by side: the same scenario, vehicle and seeds, each in its own loops.

Each is compared with the first, flight by flight, until it is known to be better, worse or alike.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.errors import FlightError
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.external import ExternalAutopilot, ExternalPlan, fly_external
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.estimator_view import EstimatorView, steady_rmse_deg
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.law.form import Law
from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.studies.campaign.paired import Change, error_ratio, find_change
from gustproof.types import Records


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonRow:
    """Medians over the flights of one controller; angles over three axes."""

    name: str
    """Controller."""
    steady_rmse_deg: float
    """[deg] rms of the true attitude with each axis' mean removed."""
    rmse_deg: float
    """[deg] rms of the true attitude; it holds the heading error of an autopilot's compass."""
    own_rmse_deg: float | None
    """[deg] rms of the error that an autopilot sees itself; `None` for a law here."""
    torque_slew_rms: float
    """[N*m/s] rms of the commanded torque's change."""
    realtime_factor: float | None
    """[-] simulated time over wall time; `None` for a law here."""

    flights: int
    """Number of flights."""
    ratio: IntervalEstimate | None
    """[-] `steady_rmse_deg` over that of the first controller in the same flights; `None` for the first."""

    @property
    def change(self) -> Change | None:
        """Verdict beside the first controller; `None` for the first."""
        return None if self.ratio is None else find_change(self.ratio)

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON values."""
        found = {name: value for name, value in asdict(self).items() if name != "ratio"}
        value, low, high = self.ratio or (None, None, None)
        ends = {"error_ratio": value, "error_ratio_low": low, "error_ratio_high": None if high == math.inf else high}
        return {**found, **ends, "verdict": None if self.change is None else self.change.value}


def compare(
    scenario: Scenario,
    vehicle: Vehicle,
    controllers: Mapping[str, ExternalAutopilot | Law],
    seeds: Sequence[int],
    progress: Callable[[float, str], None] = lambda *_: None,
) -> list[ComparisonRow]:
    """Fly controllers, by their names, with the same seeds and return the row of each; autopilots leave no files.

    A controller flies on, seed by seed, until its error over that of the first is known, see `find_change`.

    Raises
    ------
    ConfigError
        If an autopilot can't be started as requested.
    FlightError
        If a flight ends before the scenario does.
    """
    named = list(controllers.items())
    flown: list[list[_Flown]] = [[] for _ in named]
    still = list(range(len(named)))
    for j, seed in enumerate(seeds):
        for place, i in enumerate(still):
            name, controller = named[i]
            progress((j + place / len(still)) / len(seeds), f"{name}, seed {seed}")
            flown[i].append(_fly(scenario, vehicle, controller, seed))
        if len(named) > 1:
            still = [0, *(i for i in still[1:] if find_change(_ratio(flown[i], flown[0])) is Change.OPEN)]
            if len(still) == 1:
                break
    first = flown[0]
    return [
        _median_row(name, each, _ratio(each, first) if i else None)
        for i, (name, each) in enumerate(zip(controllers, flown, strict=True))
    ]


class _Flown(NamedTuple):
    """Figures of one flight, as of `ComparisonRow`."""

    steady_rmse_deg: float  # [deg]
    rmse_deg: float  # [deg]
    own_rmse_deg: float | None  # [deg]
    torque_slew_rms: float  # [N*m/s]
    realtime_factor: float | None  # [-]


def _ratio(flown: Sequence[_Flown], first: Sequence[_Flown]) -> IntervalEstimate:
    return error_ratio([each.steady_rmse_deg for each in flown], [each.steady_rmse_deg for each in first[: len(flown)]])


def _fly(scenario: Scenario, vehicle: Vehicle, controller: ExternalAutopilot | Law, seed: int) -> _Flown:
    if isinstance(controller, Law):
        records = fly_direct(scenario, controller, vehicle=vehicle, seed=seed)
        return _make_row(records, measure(records, vehicle, scenario), None)
    with TemporaryDirectory() as folder:
        flight = fly_external(ExternalPlan(scenario, controller, vehicle, seed, real_time=False), Path(folder))
    if flight.outcome is FlightOutcome.INTERRUPTED:
        raise KeyboardInterrupt  # taken by the flight, for its recording
    if flight.outcome is not FlightOutcome.DONE or flight.metrics is None:
        raise FlightError(flight.message)
    return _make_row(flight.records, flight.metrics, flight.estimator_view)


def _make_row(records: Records, figures: Metrics, view: EstimatorView | None) -> _Flown:
    return _Flown(
        steady_rmse_deg=steady_rmse_deg(records),
        rmse_deg=figures.rmse_deg,
        own_rmse_deg=None if view is None else view.control_rmse_deg,
        torque_slew_rms=figures.torque_slew_rms,
        realtime_factor=figures.realtime_factor or None,
    )


def _median_row(name: str, flown: Sequence[_Flown], ratio: IntervalEstimate | None) -> ComparisonRow:
    own = [each.own_rmse_deg for each in flown if each.own_rmse_deg is not None]
    speeds = [each.realtime_factor for each in flown if each.realtime_factor is not None]
    return ComparisonRow(
        name=name,
        steady_rmse_deg=median(each.steady_rmse_deg for each in flown),
        rmse_deg=median(each.rmse_deg for each in flown),
        own_rmse_deg=median(own) if own else None,
        torque_slew_rms=median(each.torque_slew_rms for each in flown),
        realtime_factor=median(speeds) if speeds else None,
        flights=len(flown),
        ratio=ratio,
    )
