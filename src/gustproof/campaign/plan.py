"""What a campaign flies: a scenario, laws, and what is drawn anew for each case.

Each law flies the same cases, so that they can be compared case by case. Run `k` of `runs` is case `k % cases` with
law `k // cases`: the first law's runs come first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario
from firmware_model.config.spreads import Spread
from firmware_model.config.uncertainty import VehicleSet, make_vehicle_set
from firmware_model.errors import ConfigError
from gustproof.campaign.sampling import Array, Sampling, draw_deltas, flight_seeds
from gustproof.law.form import Law, parse_law
from gustproof.simulate.batch import Case
from gustproof.versions import software_versions

FORMAT = "gustproof-campaign-1"
_GUST = "gust_scale"
_ATTITUDE = ("initial_roll_deg", "initial_pitch_deg", "initial_yaw_deg")


class DispersionKind(Enum):
    """What may be drawn anew."""

    VEHICLE = "vehicle"
    """Numbers with a spread in the vehicle file, but for the gyro's."""
    GYRO = "gyro"
    """Numbers of the gyro with a spread in the vehicle file."""
    GUST = "gust"
    """How strong the gusts are."""
    ATTITUDE = "attitude"
    """In which attitude the flight begins."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Campaign:
    """All that is needed to fly a campaign, or any run of it, again.

    Raises
    ------
    ConfigError
        If two laws have one name, or one steps at another rate than the scenario.
    """

    scenario: Scenario
    """Script."""
    laws: tuple[Law, ...]
    """Laws, each with a name of its own."""
    vehicles: VehicleSet
    """Vehicle with its spreads."""
    spreads: Mapping[str, Spread]
    """What is drawn, by name, each with its own unit."""
    cases: int
    """Cases: runs of each law."""
    sampling: Sampling = Sampling.UNIFORM
    """How it is drawn."""
    seed: int = 1
    """Seed of all draws; gusts and noise of each case have a seed of their own, made from it."""

    def __post_init__(self) -> None:
        """Check that the laws can fly it."""
        names = [law.name for law in self.laws]
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(f"law '{name}': given {names.count(name)} times; each needs a name of its own")
        for law in self.laws:
            if law.dt != self.scenario.dt:
                every = f"scenario '{self.scenario.name}' every {self.scenario.dt} s"
                raise ConfigError(f"law '{law.name}' steps every {law.dt} s, {every}")

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.cases * len(self.laws)

    def law_of(self, run: int) -> Law:
        """Return the law that flies a run."""
        return self.laws[run // self.cases]

    def deltas(self, first: int, count: int) -> Array:
        """Return what is drawn for the cases from `first` on, (count, spreads), normalised."""
        return draw_deltas(self.sampling, self.seed, self.cases, len(self.spreads), first, count)

    def flight_seeds(self, first: int, count: int) -> list[int]:
        """Return the seeds of gusts and noise of the cases from `first` on."""
        return flight_seeds(self.seed, first, count)

    def flown(self, delta: Sequence[float], seed: int) -> Case:
        """Return what is flown at the normalised `delta` of each spread.

        Raises
        ------
        ConfigError
            If there can be no such vehicle, or no flight begins so.
        """
        drawn = dict(zip(self.spreads, delta, strict=True))
        attitude = self.scenario.initial_attitude_deg
        roll, pitch, yaw = (self._value(name, drawn, usual) for name, usual in zip(_ATTITUDE, attitude, strict=True))
        vehicle = self.vehicles.at({name: value for name, value in drawn.items() if name in self.vehicles.spreads})
        gust_scale = self._value(_GUST, drawn, 1.0)
        case = {"vehicle": vehicle, "seed": seed, "gust_scale": gust_scale, "initial_attitude_deg": (roll, pitch, yaw)}
        return validate(Case, case, "case")

    def _value(self, name: str, drawn: Mapping[str, float], usual: float) -> float:
        return self.spreads[name].value(drawn[name]) if name in drawn else usual

    def note(self) -> dict[str, Any]:
        """Return the campaign as JSON has it, from which `parse_campaign` makes it again, and the versions that fly it."""
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
    """Return what is drawn unless something else is asked for: gusts, and whatever the vehicle file has a spread of."""
    of_gyro = {name.startswith("gyro.") for name in vehicles.spreads}
    found = {DispersionKind.VEHICLE: False in of_gyro, DispersionKind.GUST: True, DispersionKind.GYRO: True in of_gyro}
    return [kind for kind, there in found.items() if there]


def select_spreads(
    vehicles: VehicleSet, scenario: Scenario, wanted: Sequence[DispersionKind], *, gust: float, attitude_deg: float
) -> dict[str, Spread]:
    """Return what is drawn: gusts 1 - `gust` to 1 + `gust` times as strong, angles within `attitude_deg` of the script.

    Raises
    ------
    ConfigError
        If the vehicle file has no spread of what is wanted.
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


def parse_campaign(note: Any, source: Path | str) -> Campaign:
    """Return the campaign that a note says.

    Raises
    ------
    ConfigError
        If it says none.
    """
    try:
        if note["format"] != FORMAT:
            raise ConfigError(f"{source}: its format is {note['format']!r}, not {FORMAT!r}")
        return Campaign(
            scenario=validate(Scenario, note["scenario"], f"{source}: scenario"),
            laws=tuple(parse_law(law, f"{source}: law") for law in note["laws"]),
            vehicles=make_vehicle_set(note["vehicle"], f"{source}: vehicle"),
            spreads={name: Spread(**spread) for name, spread in note["spreads"].items()},
            cases=int(note["runs"]), sampling=Sampling(note["sampling"]), seed=int(note["seed"]),
        )  # fmt: skip
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ConfigError(f"{source}: does not say what was flown") from None
