"""Real autopilots and laws side by side: the same scenario, vehicle and seeds, each in its own loops."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.errors import FlightError
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.external import ExternalAutopilot, ExternalPlan, fly_external
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.estimator_view import EstimatorView, steady_rmse_deg
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.law.form import Law
from gustproof.types import Records


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonRow:
    """Medians over the seeds of one controller; angles over three axes."""

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

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON values."""
        return asdict(self)


def compare(
    scenario: Scenario,
    vehicle: Vehicle,
    controllers: Sequence[ExternalAutopilot | Law],
    seeds: Sequence[int],
    progress: Callable[[float, str], None] = lambda *_: None,
) -> list[ComparisonRow]:
    """Fly each controller with each seed and return its row; autopilots leave no files.

    Raises
    ------
    ConfigError
        If an autopilot can't be started as requested.
    FlightError
        If a flight ends before the scenario does.
    """
    rows = []
    for i, controller in enumerate(controllers):
        found = []
        for j, seed in enumerate(seeds):
            progress((i + j / len(seeds)) / len(controllers), f"{controller.name}, seed {seed}")
            found.append(_fly(scenario, vehicle, controller, seed))
        rows.append(_median_row(controller.name, found))
    return rows


def _fly(scenario: Scenario, vehicle: Vehicle, controller: ExternalAutopilot | Law, seed: int) -> ComparisonRow:
    if isinstance(controller, Law):
        records = fly_direct(scenario, controller, vehicle=vehicle, seed=seed)
        return _make_row(controller.name, records, measure(records, vehicle, scenario, 0.0), None)
    with TemporaryDirectory() as folder:
        flight = fly_external(ExternalPlan(scenario, controller, vehicle, seed, real_time=False), Path(folder))
    if flight.outcome is FlightOutcome.INTERRUPTED:
        raise KeyboardInterrupt  # taken by the flight, for its recording
    if flight.outcome is not FlightOutcome.DONE or flight.metrics is None:
        raise FlightError(flight.message)
    return _make_row(controller.name, flight.records, flight.metrics, flight.estimator_view)


def _make_row(name: str, records: Records, figures: Metrics, view: EstimatorView | None) -> ComparisonRow:
    return ComparisonRow(
        name=name,
        steady_rmse_deg=steady_rmse_deg(records),
        rmse_deg=figures.rmse_deg,
        own_rmse_deg=None if view is None else view.control_rmse_deg,
        torque_slew_rms=figures.torque_slew_rms,
        realtime_factor=figures.realtime_factor or None,
    )


def _median_row(name: str, rows: Sequence[ComparisonRow]) -> ComparisonRow:
    own = [row.own_rmse_deg for row in rows if row.own_rmse_deg is not None]
    speeds = [row.realtime_factor for row in rows if row.realtime_factor is not None]
    return ComparisonRow(
        name=name,
        steady_rmse_deg=median(row.steady_rmse_deg for row in rows),
        rmse_deg=median(row.rmse_deg for row in rows),
        own_rmse_deg=median(own) if own else None,
        torque_slew_rms=median(row.torque_slew_rms for row in rows),
        realtime_factor=median(speeds) if speeds else None,
    )
