"""Repeat any run of a campaign from its table alone."""

import math
from pathlib import Path
from typing import Any, NamedTuple

from firmware_model.errors import ConfigError
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.routes.flight import Flight, FlightPlan
from gustproof.studies.campaign.plan import Campaign
from gustproof.studies.campaign.reader import read_campaign, read_run
from gustproof.studies.campaign.worker import FIGURES, delta_column, requirement_columns


class CampaignRun(NamedTuple):
    """A run of a campaign."""

    table: Path
    """File of the campaign."""
    campaign: Campaign
    """Scenario, laws and dispersions."""
    row: dict[str, Any]
    """Results by column."""

    @property
    def plan(self) -> FlightPlan:
        """Plan of a flight that repeats the run."""
        delta = [self.row[delta_column(name)] for name in self.campaign.spreads]
        case = self.campaign.make_case(delta, self.row["seed"])
        law = self.campaign.law_of(self.row["run"])
        script = case.apply_to(self.campaign.scenario)
        nominal = None if isinstance(law, ExternalAutopilot) else self.campaign.vehicles.nominal
        return FlightPlan(script, law, case.vehicle, case.seed, real_time=False, nominal=nominal)

    def differences(self, flight: Flight) -> list[str]:
        """Return the names of the figures in which a flight differs from the run by any bit."""
        figures = {name: getattr(flight.metrics, name, None) for name in (*FIGURES, "rho_in_bounds")}
        names = requirement_columns(self.campaign.scenario.require)
        figures |= {name: result.value for name, result in zip(names, flight.requirements, strict=True)}
        missing = {name: None if value is None or math.isnan(value) else value for name, value in figures.items()}
        return [name for name, value in missing.items() if self.row[name] != value]


def find_run(run: str) -> CampaignRun:
    """Return a run by table name and run number, e.g. `mc.parquet:4711`.

    Raises
    ------
    ConfigError
        If there is no such table, or no such run in it.
    """
    name, _, number = run.rpartition(":")
    if not name or not number.isdecimal():
        raise ConfigError(f"'{run}': give a table and a run's number, e.g. mc.parquet:4711")
    table = Path(name)
    campaign = read_campaign(table)
    return CampaignRun(table, campaign, read_run(table, int(number)))
