"""Any run of a campaign again, from its table alone."""

import math
from pathlib import Path
from typing import Any, NamedTuple

from pydantic_core import to_jsonable_python

from firmware_model.config.scenario import load_scenario
from firmware_model.errors import ConfigError
from gustproof.campaign.plan import Campaign
from gustproof.campaign.reader import read_campaign, read_run
from gustproof.campaign.worker import FIGURES, delta_column, requirement_columns
from gustproof.law.form import load_law
from gustproof.simulate.flight import Flight, FlightPlan


class CampaignRun(NamedTuple):
    """A run of a campaign."""

    table: Path
    """File of the campaign."""
    campaign: Campaign
    """What was flown."""
    row: dict[str, Any]
    """What came of it, by column."""

    @property
    def plan(self) -> FlightPlan:
        """What is to be flown to fly it again."""
        delta = [self.row[delta_column(name)] for name in self.campaign.spreads]
        case = self.campaign.flown(delta, self.row["seed"])
        law = self.campaign.law_of(self.row["run"])
        return FlightPlan(case.apply_to(self.campaign.scenario), law, case.vehicle, case.seed, real_time=False)

    def check(self, scenario: str | None, law: str | None) -> None:
        """Refuse another scenario or law than those of the run, `None` is any.

        Raises
        ------
        ConfigError
            If they differ, in name or in content.
        """
        told, flown = f"{self.table}, run {self.row['run']}", self.campaign
        if scenario is not None:
            script = load_scenario(scenario)
            if script.name != flown.scenario.name:
                raise ConfigError(f"{told}: flown in scenario '{flown.scenario.name}', not '{script.name}'")
            if to_jsonable_python(script) != to_jsonable_python(flown.scenario):
                raise ConfigError(f"{told}: flown in a scenario '{script.name}' that is not this one")
        if law is not None:
            given, ours = load_law(law), flown.law_of(self.row["run"])
            if given.name != ours.name:
                raise ConfigError(f"{told}: flown by '{ours.name}', not '{given.name}'{self._same_case(given.name)}")
            if given.to_dict() != ours.to_dict():
                raise ConfigError(f"{told}: flown by a law '{given.name}' that is not this one")

    def _same_case(self, law: str) -> str:
        names = [each.name for each in self.campaign.laws]
        if law not in names:
            return ""
        return f", which flew this case in run {names.index(law) * self.campaign.cases + self.row['case']}"

    def differences(self, flight: Flight) -> list[str]:
        """Return the names of the figures in which a flight is not the run to the bit."""
        figures = {name: getattr(flight.metrics, name, None) for name in (*FIGURES, "rho_in_bounds")}
        names = requirement_columns(self.campaign.scenario.require)
        figures |= {name: result.value for name, result in zip(names, flight.requirements, strict=True)}
        missing = {name: None if value is None or math.isnan(value) else value for name, value in figures.items()}
        return [name for name, value in missing.items() if self.row[name] != value]


def find_run(run: str) -> CampaignRun:
    """Return a run by the name of its table and its number, as `mc.parquet:4711`.

    Raises
    ------
    ConfigError
        If there is no such table, or no such run in it.
    """
    name, _, number = run.rpartition(":")
    if not name or not number.isdecimal():
        raise ConfigError(f"--run '{run}': give a table and a run's number, as mc.parquet:4711")
    table = Path(name)
    campaign = read_campaign(table)
    return CampaignRun(table, campaign, read_run(table, int(number)))
