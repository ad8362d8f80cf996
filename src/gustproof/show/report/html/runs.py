"""Flights of a report, read from their bags."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from firmware_model.errors import ConfigError
from gustproof.flight.controllers.external_autopilot import parse_autopilot
from gustproof.flight.recording.bag import read_bag, read_estimate_topics
from gustproof.flight.recording.folder import find_bags
from gustproof.flight.routes.flight import Flight, parse_metadata, parse_nominal
from gustproof.flight.routes.outcome import FlightOutcome, describe
from gustproof.types import Records
from gustproof.version import software_versions

_PILOTS = ("law", "autopilot", "controller")
MAX_RUNS = 12
"""Most flights on a page: more curves cannot be told apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportRun(Flight):
    """One recorded flight of a law, another controller or a real autopilot."""

    label: str
    """Name beside the other runs."""
    versions: Mapping[str, str]
    """Versions of the software that flew it."""


def read_runs(paths: Iterable[Path]) -> tuple[ReportRun, ...]:
    """Return the flights in `paths`: folders of `gustproof fly`, or bags.

    Raises
    ------
    ConfigError
        If a folder holds no bag, a bag is unreadable, or there are more than `MAX_RUNS`.
    """
    bags = [bag for path in paths for bag in find_bags(path)]
    if len(bags) > MAX_RUNS:
        raise ConfigError(f"{len(bags)} flights, a report shows at most {MAX_RUNS}")
    read = [(bag, *read_bag(bag)) for bag in bags]
    labels = _unique_labels([about for _, about, _ in read])
    return tuple(_make_run(label, *flight) for label, flight in zip(labels, read, strict=True))


def _make_run(label: str, bag: Path, about: dict[str, Any], records: Records) -> ReportRun:
    if about.get("law", ...) is None and not (about.get("autopilot") or about.get("controller")):
        raise ConfigError(f"{bag}: flown by a controller of its own; a page needs its law")
    scenario, controller, vehicle, seed, _ = parse_metadata(about, bag)
    try:
        outcome, versions = FlightOutcome[str(about["outcome"]).upper()], dict(about["versions"])
        timing = {name: int(value) for name, value in about["pace"].items()} if "pace" in about else None
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError):
        raise ConfigError(f"{bag}: does not say what was flown") from None
    flown: dict[str, Any] = {"scenario": scenario, "controller": controller, "vehicle": vehicle, "seed": seed}
    flown["nominal"] = parse_nominal(about, bag)
    if controller is None:
        parse_autopilot(about["autopilot"], bag)
        flown |= {"autopilot": about["autopilot"], "estimates": read_estimate_topics(bag)}
    reason = (flown.get("autopilot") or {}).get("reason")
    words = describe(outcome, scenario, records) if outcome is FlightOutcome.DIVERGED else outcome.value
    message = f"{words} ({reason})" if reason else words
    said: dict[str, Any] = {"outcome": outcome, "message": message, "timing": timing, "versions": versions}
    return ReportRun(**flown, **said, label=label, bag=bag, records=records)


def as_runs(flights: Sequence[Flight]) -> tuple[ReportRun, ...]:
    """Return flights that were flown here and now, for a report.

    Raises
    ------
    ConfigError
        If there are more than `MAX_RUNS`.
    """
    if len(flights) > MAX_RUNS:
        raise ConfigError(f"{len(flights)} flights, a report shows at most {MAX_RUNS}")
    labels = _unique_labels([_describe(flight) for flight in flights])
    said = ({field.name: getattr(flight, field.name) for field in fields(Flight)} for flight in flights)
    versions = software_versions()
    return tuple(ReportRun(**each, label=label, versions=versions) for each, label in zip(said, labels, strict=True))


def _describe(flight: Flight) -> dict[str, Any]:
    """Return the names of a flight as a bag has them."""
    names = {"law": flight.pilot_name, "scenario": flight.scenario.name, "vehicle": flight.vehicle.name}
    return {**{key: {"name": name} for key, name in names.items()}, "seed": flight.seed}


def _unique_labels(flights: list[dict[str, Any]]) -> list[str]:
    """Return the controller of each flight, with scenario, vehicle and seed where they differ."""
    parts = [[_name_of(about, next(filter(about.get, _PILOTS), _PILOTS[0]))] for about in flights]
    for key in ("scenario", "vehicle", "seed"):
        values = [_name_of(about, key) for about in flights]
        if len(set(values)) > 1:
            for part, value in zip(parts, values, strict=True):
                part.append(value)
    labels = [", ".join(part) for part in parts]
    repeats = [labels[: i + 1].count(label) for i, label in enumerate(labels)]
    return [f"{label} ({n})" if n > 1 else label for label, n in zip(labels, repeats, strict=True)]


def _name_of(about: dict[str, Any], key: str) -> str:
    """Return the name of a flight's law, scenario or vehicle, or its seed, if the bag has it."""
    value = about.get(key)
    return str(value.get("name")) if isinstance(value, dict) else f"{key} {value}"
