"""Tasks of a league, each done by one worker and kept by its key: tune a law, measure a price, fly a cell."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.validation import sanitize_line
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from gustproof.baselines.price import measure_price
from gustproof.campaign.plan import flies_in_lanes
from gustproof.entries.entry import Pilot
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.league.course import WORST_DEG
from gustproof.league.entrants import Entrant, make_pilot, pilot_digest
from gustproof.league.ledger import Result, content_key
from gustproof.scoring.requirements import judge
from gustproof.simulate.batch import Case, make_batch_simulator
from gustproof.simulate.outcome import FlightOutcome
from gustproof.simulate.pilots import fly_pilot
from gustproof.version import software_versions


class Task(Protocol):
    """Work whose result depends on its key alone."""

    @property
    def key(self) -> str:
        """Key of the result."""
        ...

    @property
    def label(self) -> str:
        """Name in progress and errors."""
        ...

    def run(self) -> Result:
        """Return the result as JSON values."""
        ...

    def fail(self, reason: str) -> Result:
        """Return the result of a task whose worker died."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tune:
    """Search for an entrant's law on a vehicle; the result has `law` or, without one, `refused`."""

    entrant: Entrant
    """Entrant."""
    vehicles: VehicleSet
    """Vehicle and its spreads."""

    @property
    def key(self) -> str:
        """Key of the result."""
        return content_key(
            task="tune", source=self.entrant.source, vehicle=self.vehicles.document, versions=software_versions()
        )

    @property
    def label(self) -> str:
        """Name in progress and errors."""
        return f"tuning {self.entrant.name} for {self.vehicles.nominal.name}"

    def run(self) -> Result:
        """Return the law, or why there is none."""
        try:
            pilot = make_pilot(self.entrant, self.vehicles)
        except (DesignError, ConfigError) as error:
            return self.fail(sanitize_line(str(error)))
        return {"law": pilot.to_dict()} if isinstance(pilot, Law) else self.fail("not a law")

    def fail(self, reason: str) -> Result:
        """Return the result without a law."""
        return {"refused": reason}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weigh:
    """Measurement of a pilot's price on a vehicle; the result has `price` or, without one, `refused`."""

    pilot: Pilot
    """Law or entry."""
    vehicle: Vehicle
    """Vehicle."""
    scenario: Scenario
    """Turbulence of the torque slew, sample time and delay."""

    @property
    def key(self) -> str:
        """Key of the result."""
        return content_key(
            task="weigh",
            pilot=pilot_digest(self.pilot),
            vehicle=self.vehicle,
            scenario=self.scenario,
            versions=software_versions(),
        )

    @property
    def label(self) -> str:
        """Name in progress and errors."""
        return f"price of {self.pilot.name} on {self.vehicle.name}"

    def run(self) -> Result:
        """Return the price, or why there is none."""
        try:
            with np.errstate(all="ignore"):  # a loop that diverges is a result
                return {"price": measure_price(self.pilot, self.vehicle, self.scenario).to_dict()}
        except (DesignError, ConfigError, ValueError, np.linalg.LinAlgError) as error:
            return self.fail(sanitize_line(str(error)))

    def fail(self, reason: str) -> Result:
        """Return the result without a price."""
        return {"refused": reason}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fly:
    """Flights of a pilot in one scenario; the result has `errors_deg` and `failures`, one for each seed."""

    pilot: Pilot
    """Law or entry."""
    vehicle: Vehicle
    """Vehicle that is flown."""
    nominal: Vehicle
    """Vehicle that the pilot is made for."""
    scenario: Scenario
    """Script, with the one requirement that gives the error."""
    seeds: Sequence[int]
    """(runs,) seeds."""

    @property
    def key(self) -> str:
        """Key of the result."""
        return content_key(
            task="fly",
            pilot=pilot_digest(self.pilot),
            vehicle=self.vehicle,
            nominal=self.nominal,
            scenario=self.scenario,
            seeds=self.seeds,
            versions=software_versions(),
        )

    @property
    def label(self) -> str:
        """Name in progress and errors."""
        return f"{self.pilot.name}, {self.vehicle.name}, {self.scenario.name}"

    def run(self) -> Result:
        """Return the error [deg] of each flight, `None` for one that failed, and the reasons."""
        with np.errstate(all="ignore"):  # a flight that diverges is a result
            in_lanes = flies_in_lanes(self.pilot) and not self.scenario.has_link_script
            flights = self._fly_lanes() if in_lanes else [self._fly(seed) for seed in self.seeds]
        errors, failures = zip(*flights, strict=True)
        return {"errors_deg": list(errors), "failures": list(failures)}

    def fail(self, reason: str) -> Result:
        """Return the result of flights that all failed."""
        return {"errors_deg": [None] * len(self.seeds), "failures": [reason] * len(self.seeds)}

    def _fly_lanes(self) -> list[tuple[float | None, str]]:
        cases = [Case(vehicle=self.vehicle, seed=seed) for seed in self.seeds]
        flown = make_batch_simulator(self.scenario, self.pilot)(cases)
        return [_judge_error(each.requirements[0].value) for each in flown]

    def _fly(self, seed: int) -> tuple[float | None, str]:
        try:
            flight = fly_pilot(self.scenario, self.pilot, vehicle=self.vehicle, seed=seed, nominal=self.nominal)
        except (ConfigError, ValueError) as error:
            return None, sanitize_line(str(error))
        if flight.outcome is not FlightOutcome.DONE:
            return None, sanitize_line(flight.message)
        return _judge_error(judge(flight.records, self.scenario, self.vehicle)[0].value)


def _judge_error(error: float) -> tuple[float | None, str]:
    """Return the error [deg] and an empty text, or why it does not count."""
    if not math.isfinite(error):
        return None, "diverged"
    return (error, "") if error < WORST_DEG else (None, f"tumbled: error {error:.0f} deg")


def run_task(task: Task) -> Result:
    """Do a task: the function that workers call."""
    return task.run()
