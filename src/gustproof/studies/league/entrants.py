"""Entrants of the league: a name or a file each, and the pilot that it means for a vehicle."""

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
from gustproof.flight.controllers.entry import ControllerKind, Pilot, parse_controller
from gustproof.flight.controllers.stepper import make_stepper
from gustproof.law.form import Law, list_laws, load_law
from gustproof.law.write.matrices import read_law

VEHICLE_FIELD = "{vehicle}"
"""Part of a file's name that stands for the name of the vehicle."""
REFERENCE = "pid-fair"
"""Entrant whose error on a vehicle is the unit of the score there."""
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
"""Sources of the entrants by default."""
_KINDS = {REFERENCE: LawKind.PID, **{kind.value: kind for kind in LawKind}}
_Tuner = Callable[[VehicleSet, float], Law]


@dataclass(frozen=True, slots=True, kw_only=True)
class Entrant:
    """An entry as its user names it."""

    name: str
    """Name in tables."""
    source: str
    """Text that names it on the command line."""


def tuning_air() -> Scenario:
    """Return the turbulence that laws are tuned in."""
    return load_scenario("paper-turbulence")


def parse_entrant(source: str) -> Entrant:
    """Return the entrant of a text: a law's name, NAME@PEAK, a law file, or what `parse_controller` takes.

    Raises
    ------
    ConfigError
        If it names nothing that can be entered.
    """
    name, at, peak = source.partition("@")
    if at and name in _tuners():
        _parse_peak(source, peak)
        return Entrant(name=source, source=source)
    if source in _tuners():
        return Entrant(name=source, source=source)
    if is_law_file(source):
        return Entrant(name=Path(source.replace(VEHICLE_FIELD, "")).stem.strip("-_."), source=source)
    try:
        entry = parse_controller(source.replace(VEHICLE_FIELD, "paper"))
    except ConfigError as error:
        known = ", ".join(_tuners())
        raise ConfigError(f"--entry '{source}': no law, file or object of that name ({error}); laws: {known}") from None
    if entry.kind is ControllerKind.PROGRAM:
        raise ConfigError(f"--entry '{source}': programs fly in `fly` and `worst-case`, the league takes what repeats")
    return Entrant(name=entry.name.replace("_", "-"), source=source)


def parse_entrants(sources: Iterable[str]) -> tuple[Entrant, ...]:
    """Return the entrants of some texts, of which `ALL` stands for the roster; see `parse_entrant`."""
    return tuple(parse_entrant(name) for each in sources for name in (ROSTER if each == ALL else (each,)))


def is_law_file(source: str) -> bool:
    """Return whether a text names a law file, or a folder of tables."""
    return Path(source).suffix in (".json", ".mat") or Path(source).is_dir()


def make_pilot(entrant: Entrant, vehicles: VehicleSet) -> Pilot:
    """Return what flies for an entrant on a vehicle; a law that is not shipped for it is tuned.

    A Python object is made once and a library loaded, so that mistakes are told before the first flight.

    Raises
    ------
    DesignError
        If no law of that kind is found for the vehicle at its price.
    ConfigError, LawFileError
        If a file is wrong.
    """
    source, vehicle = entrant.source.replace(VEHICLE_FIELD, vehicles.nominal.name), vehicles.nominal
    name, at, peak = source.partition("@")
    if not at and name in list_laws() and (law := load_law(name)).provenance.vehicle == vehicle.name:
        return law
    if name in _tuners():
        return _tuners()[name](vehicles, _parse_peak(source, peak) if at else SENSITIVITY_PEAK)
    if is_law_file(source):
        return read_law(source)
    entry = parse_controller(source)
    make_stepper(entry, vehicle)
    return entry


def is_tuned(entrant: Entrant) -> bool:
    """Return whether an entrant's laws are searched here, and worth keeping."""
    return entrant.source.partition("@")[0] in _tuners()


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
