"""Plan of a campaign: a scenario, laws, and the dispersions drawn for each case.

Each law flies the same cases, so laws can be compared case by case. Run `k` of `runs` is case `k % cases` with law
`k // cases`: the first law's runs come first.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario
from firmware_model.config.spreads import Spread
from firmware_model.config.uncertainty import VehicleSet, make_vehicle_set
from firmware_model.errors import ConfigError
from gustproof.flight.controllers.external_autopilot import (
    AnyController,
    ExternalAutopilot,
    confirm_autopilot,
    parse_autopilot,
)
from gustproof.flight.controllers.library import load_library
from gustproof.flight.controllers.user_controller import (
    ControllerKind,
    UserController,
    confirm_controller,
    parse_controller_metadata,
)
from gustproof.flight.routes.batch import Case
from gustproof.law.form import Law, parse_law
from gustproof.law.references import describe_other_rate
from gustproof.robust.shown import Shown
from gustproof.studies.campaign.sampling import Sampling, draw_deltas, flight_seeds
from gustproof.types import Array
from gustproof.version import software_versions

FORMAT = "gustproof-campaign-1"
_GUST = "gust_scale"
_ATTITUDE = ("initial_roll_deg", "initial_pitch_deg", "initial_yaw_deg")


class DispersionKind(Enum):
    """Groups of dispersions that a campaign can draw.

    Examples
    --------
    >>> from gustproof import DispersionKind
    >>> [kind.value for kind in DispersionKind]
    ['vehicle', 'gyro', 'gust', 'attitude']
    """

    VEHICLE = "vehicle"  # numbers with a spread in the vehicle file, except those of the gyro
    GYRO = "gyro"  # numbers of the gyro with a spread in the vehicle file
    GUST = "gust"  # strength of the gusts
    ATTITUDE = "attitude"  # initial attitude


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Campaign(Shown):
    """Complete description of a campaign, enough to repeat it or any of its runs.

    Raises
    ------
    ConfigError
        If two laws have the same name, or the rate of a law is not the scenario's.

    Examples
    --------
    >>> from gustproof import Campaign, DispersionKind, load_law, load_scenario, load_vehicle_set, select_spreads
    >>> scenario, vehicles = load_scenario("paper-turbulence"), load_vehicle_set("paper")
    >>> spreads = select_spreads(vehicles, scenario, [DispersionKind.GUST], gust=0.5, attitude_deg=0.0)
    >>> laws = (load_law("pid-fair"), load_law("flagship"))
    >>> campaign = Campaign(scenario=scenario, laws=laws, vehicles=vehicles, spreads=spreads, cases=1000)
    >>> campaign.runs
    2000
    """

    scenario: Scenario
    """Script."""
    laws: tuple[AnyController, ...]
    """Laws, and entries and real autopilots that fly in place of one, with distinct names."""
    vehicles: VehicleSet
    """Vehicle with its spreads."""
    spreads: Mapping[str, Spread]
    """Dispersions by name, each with its own unit."""
    cases: int
    """Number of cases: runs of each law."""
    sampling: Sampling = Sampling.UNIFORM
    """Sampling method of the dispersions."""
    seed: int = 1
    """Seed of all draws; each case derives its own seed of gusts and noise from it."""

    def __post_init__(self) -> None:
        """Check names and rates of the laws."""
        names = [law.name for law in self.laws]
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(f"law '{name}': given {names.count(name)} times; names must be distinct")
        for law in self.laws:
            if isinstance(law, Law) and (line := describe_other_rate(self.scenario, law.name, law.dt)):
                raise ConfigError(line)

    def lines(self) -> list[str]:
        """Return what is flown, how often, and what is drawn."""
        drawn = ", ".join(self.spreads) or "gusts and noise alone"
        return [
            f"campaign in {self.scenario.name} on vehicle {self.vehicles.nominal.name}",
            f"laws: {', '.join(law.name for law in self.laws)}",
            f"cases: {self.cases:,} of each, seed {self.seed}",
            f"drawn: {drawn}, {self.sampling.value}",
        ]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.cases * len(self.laws)

    @property
    def flies_in_lanes(self) -> bool:
        """True if many runs are flown side by side in one loop, without messages."""
        flown = filter(is_given, self.laws)
        return not self.scenario.has_link_script and all(map(flies_in_lanes, flown))

    def law_of(self, run: int) -> AnyController:
        """Return the law that flies a run."""
        return self.laws[run // self.cases]

    def draw_deltas(self, first: int, count: int) -> Array:
        """Return the normalised deltas of the cases from `first` on, (count, spreads)."""
        return draw_deltas(self.sampling, self.seed, self.cases, len(self.spreads), first, count)

    def flight_seeds(self, first: int, count: int) -> list[int]:
        """Return the seeds of gusts and noise of the cases from `first` on."""
        return flight_seeds(self.seed, first, count)

    def make_case(self, delta: Sequence[float], seed: int) -> Case:
        """Return the case at the normalised `delta` of each spread.

        Raises
        ------
        ConfigError
            If no such vehicle can exist, or no flight can start in this attitude.
        """
        drawn = dict(zip(self.spreads, delta, strict=True))
        attitude = self.scenario.initial_attitude_deg
        roll, pitch, yaw = (self._value(name, drawn, angle) for name, angle in zip(_ATTITUDE, attitude, strict=True))
        vehicle = self.vehicles.vehicle_at(
            {name: value for name, value in drawn.items() if name in self.vehicles.spreads}
        )
        gust_scale = self._value(_GUST, drawn, 1.0)
        case = {"vehicle": vehicle, "seed": seed, "gust_scale": gust_scale, "initial_attitude_deg": (roll, pitch, yaw)}
        return validate(Case, case, "case")

    def _value(self, name: str, drawn: Mapping[str, float], default: float) -> float:
        return self.spreads[name].value(drawn[name]) if name in drawn else default

    def metadata(self) -> dict[str, Any]:
        """Return the campaign and its software versions as JSON values, input of `parse_campaign`."""
        return {
            "format": FORMAT,
            "scenario": to_jsonable_python(self.scenario),
            "vehicle": self.vehicles.document,
            "laws": [law.to_dict() for law in self.laws],
            "spreads": to_jsonable_python(self.spreads),
            "runs": self.cases,
            "sampling": self.sampling.value,
            "seed": self.seed,
            "versions": software_versions(),
        }


def usual_dispersions(vehicles: VehicleSet) -> list[DispersionKind]:
    """Return the default dispersions: gusts, and each kind with a spread in the vehicle file."""
    of_gyro = {name.startswith("gyro.") for name in vehicles.spreads}
    found = {DispersionKind.VEHICLE: False in of_gyro, DispersionKind.GUST: True, DispersionKind.GYRO: True in of_gyro}
    return [kind for kind, there in found.items() if there]


def select_spreads(
    vehicles: VehicleSet, scenario: Scenario, wanted: Sequence[DispersionKind], *, gust: float, attitude_deg: float
) -> dict[str, Spread]:
    """Return the spreads of the `wanted` kinds, by name.

    Gusts are scaled by 1 - `gust` to 1 + `gust`; initial angles are within `attitude_deg` of the script's.

    Raises
    ------
    ConfigError
        If the vehicle file has no spread of a wanted kind.

    Examples
    --------
    >>> from gustproof import DispersionKind, load_scenario, load_vehicle_set, select_spreads
    >>> vehicles, scenario = load_vehicle_set("paper"), load_scenario("paper-turbulence")
    >>> spreads = select_spreads(vehicles, scenario, [DispersionKind.GUST], gust=0.5, attitude_deg=0.0)
    >>> spreads["gust_scale"].high
    1.5
    """
    found: dict[str, Spread] = {}
    for kind in dict.fromkeys(wanted):
        if kind is DispersionKind.GUST:
            found[_GUST] = Spread(nominal=1.0, low=1.0 - gust, high=1.0 + gust)
        elif kind is DispersionKind.ATTITUDE:
            for name, angle in zip(_ATTITUDE, scenario.initial_attitude_deg, strict=True):
                found[name] = Spread(nominal=angle, low=angle - attitude_deg, high=angle + attitude_deg)
        else:
            of_gyro = kind is DispersionKind.GYRO
            theirs = {n: each for n, each in vehicles.spreads.items() if n.startswith("gyro.") is of_gyro}
            if not theirs:
                name = vehicles.document["name"]
                example = "snr_db in [gyro]" if of_gyro else "actuator_lag"
                raise ConfigError(
                    f"vehicle '{name}' has no spread to draw '{kind.value}' from: "
                    f"give {example} as {{ nominal = …, low = …, high = … }} in its file"
                )
            found |= theirs
    return found


def parse_campaign(metadata: Any, source: Path | str) -> Campaign:
    """Return the campaign described by `metadata`.

    Its laws can fly at once, all others only after `confirm`: nothing that it names is opened, loaded or started.

    Raises
    ------
    ConfigError
        If `metadata` describes no campaign.
    """
    try:
        if metadata["format"] != FORMAT:
            raise ConfigError(f"{source}: its format is {metadata['format']!r}, not {FORMAT!r}")
        return Campaign(
            scenario=validate(Scenario, metadata["scenario"], f"{source}: scenario"),
            laws=tuple(_parse_any(law, source) for law in metadata["laws"]),
            vehicles=make_vehicle_set(metadata["vehicle"], f"{source}: vehicle"),
            spreads={name: Spread(**spread) for name, spread in metadata["spreads"].items()},
            cases=int(metadata["runs"]),
            sampling=Sampling(metadata["sampling"]),
            seed=int(metadata["seed"]),
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ConfigError(f"{source}: no description of a campaign") from None


def flies_in_lanes(controller: AnyController) -> bool:
    """Return whether a controller flies in the compiled loop over many flights: laws, and C in double precision."""
    if not isinstance(controller, UserController):
        return isinstance(controller, Law)
    return controller.kind is ControllerKind.LIBRARY and not load_library(controller).is_single


def is_given(law: AnyController) -> bool:
    """Return false for an entry or an autopilot that only a file names, which can't fly."""
    return isinstance(law, Law) or law.given


def check_given(laws: Iterable[AnyController], where: object) -> None:
    """Refuse to fly what only a file names; the text begins with `where`.

    Raises
    ------
    ConfigError
        If one of `laws` is such an entry or autopilot.
    """
    for law in laws:
        if not isinstance(law, Law):
            law.check_given(where)


def confirm(law: AnyController, given: Sequence[AnyController], where: object) -> AnyController:
    """Return a law, or the one among those `given` by a user that an entry or an autopilot in a file stands for.

    Raises
    ------
    ConfigError
        If it is not among them, or is another one; the text begins with `where`.
    """
    if is_given(law) or isinstance(law, Law):
        return law
    same = next((each for each in given if each.name == law.name and type(each) is type(law)), None)
    if isinstance(law, UserController):
        return confirm_controller(law, same.source if isinstance(same, UserController) else None, where)
    return confirm_autopilot(law, same if isinstance(same, ExternalAutopilot) else None, where)


def trust(law: AnyController) -> AnyController:
    """Return what a worker flies for a campaign that this program has sent it.

    Raises
    ------
    ConfigError
        If its file is not there, or another one.
    """
    if isinstance(law, UserController):
        return confirm_controller(law, law.source, "campaign")
    return law if isinstance(law, Law) else replace(law, given=True)


def _parse_any(document: Any, source: Path | str) -> AnyController:
    if "autopilot" in document:
        return parse_autopilot(document, source)
    if "kind" in document:
        return parse_controller_metadata(document, source)
    return parse_law(document, f"{source}: law")
