"""Entries of the league: a name or a file each, and the controller that it means for a vehicle."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.errors import ConfigError
from gustproof.design.cascades.autotune import autotune_pid
from gustproof.design.derive import derive
from gustproof.design.designs import list_designs, load_design
from gustproof.design.literature.tuned import tune_baseline
from gustproof.design.shipped import PAPER_BANDWIDTH
from gustproof.design.structures import BASELINES, LawKind
from gustproof.design.tune import SENSITIVITY_PEAK, tune_law
from gustproof.flight.controllers.stepper import make_stepper
from gustproof.flight.controllers.user_controller import Controller, ControllerKind, parse_controller
from gustproof.law.form import Law, list_laws, load_law
from gustproof.law.write.matrices import read_law

VEHICLE_FIELD = "{vehicle}"
"""Part of a file's name that stands for the name of the vehicle."""
REFERENCE = "pid-fair"
"""Entry whose error on a vehicle is the unit of the score there."""
ALL = "all"
"""Source that stands for the whole `ROSTER`."""
ROSTER = (
    "flagship",
    "pid-fair",
    "indi",
    "aided",
    "flagship@1.7",
    "pid-default",
    "hinf-reference",
    "hinf-d2",
    *BASELINES,
)
"""Sources of the entries by default."""
_KINDS = {REFERENCE: LawKind.PID, **{kind.value: kind for kind in LawKind}}
_Tuner = Callable[[VehicleSet, float], Law]


@dataclass(frozen=True, slots=True, kw_only=True)
class LeagueEntry:
    """A controller as its user enters it."""

    name: str
    """Name in tables."""
    source: str
    """Text that names it on the command line."""


def tuning_air() -> Scenario:
    """Return the turbulence that laws are tuned in."""
    return load_scenario("paper-turbulence")


def parse_league_entry(source: str) -> LeagueEntry:
    """Return the entry of a text: a law's name, NAME@PEAK, a law file, or what `parse_controller` takes.

    Raises
    ------
    ConfigError
        If it names nothing that can be entered.
    """
    name, at, peak = source.partition("@")
    if at and name in _tuners():
        _parse_peak(source, peak)
        return LeagueEntry(name=source, source=source)
    if source in _tuners():
        return LeagueEntry(name=source, source=source)
    if is_law_file(source):
        return LeagueEntry(name=Path(source.replace(VEHICLE_FIELD, "")).stem.strip("-_."), source=source)
    try:
        brought = parse_controller(source.replace(VEHICLE_FIELD, "paper"))
    except ConfigError as error:
        known = ", ".join(_tuners())
        raise ConfigError(f"--entry '{source}': no law, file or object of that name ({error}); laws: {known}") from None
    if brought.kind is ControllerKind.PROGRAM:
        raise ConfigError(f"--entry '{source}': programs fly in `fly` and `worst-case`, the league takes what repeats")
    return LeagueEntry(name=brought.name.replace("_", "-"), source=source)


def parse_league_entries(sources: Iterable[str]) -> tuple[LeagueEntry, ...]:
    """Return the entries of some texts, of which `ALL` stands for the roster; see `parse_league_entry`."""
    return tuple(parse_league_entry(name) for each in sources for name in (ROSTER if each == ALL else (each,)))


def is_law_file(source: str) -> bool:
    """Return whether a text names a law file, or a folder of tables."""
    return Path(source).suffix in (".json", ".mat") or Path(source).is_dir()


def make_controller(entry: LeagueEntry, vehicles: VehicleSet) -> Controller:
    """Return what flies for an entry on a vehicle; a law that is not shipped for it is tuned.

    A Python object is made once and a library loaded, so that mistakes are reported before the first flight.

    Raises
    ------
    DesignError
        If no law of that kind is found for the vehicle within its limits.
    ConfigError, LawFileError
        If a file is wrong.
    """
    source, vehicle = entry.source.replace(VEHICLE_FIELD, vehicles.nominal.name), vehicles.nominal
    name, at, peak = source.partition("@")
    if not at and name in list_laws() and (law := load_law(name)).provenance.fits(vehicle):
        return law
    if name in _tuners():
        return _tuners()[name](vehicles, _parse_peak(source, peak) if at else SENSITIVITY_PEAK)
    if is_law_file(source):
        return read_law(source)
    brought = parse_controller(source)
    make_stepper(brought, vehicle)
    return brought


def is_tuned(entry: LeagueEntry) -> bool:
    """Return whether an entry's laws are searched here, and worth keeping."""
    return entry.source.partition("@")[0] in _tuners()


def _parse_peak(source: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"--entry '{source}': after the @ stands a sensitivity peak, such as 1.7") from None


def _tuners() -> dict[str, _Tuner]:
    """Return the procedures that give a law for any vehicle, by name."""

    def tuner(kind: LawKind) -> _Tuner:
        return lambda vehicles, peak: tune_law(kind.value, vehicles, tuning_air(), sensitivity_peak=peak).law

    def derivation(design: str) -> _Tuner:
        return lambda vehicles, _: derive(load_design(design), vehicles.nominal)[0]

    designed = {load_design(name).law or name: derivation(name) for name in list_designs()}

    def baseline(kind: str) -> _Tuner:
        return lambda vehicles, peak: tune_baseline(kind, vehicles, tuning_air(), sensitivity_peak=peak).law

    return {
        **designed,
        **{name: baseline(name) for name in BASELINES},
        "pid-default": lambda vehicles, _: autotune_pid(vehicles.nominal, bandwidth=PAPER_BANDWIDTH),
        **{name: tuner(kind) for name, kind in _KINDS.items()},
    }
