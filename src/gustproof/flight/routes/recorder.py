"""Fly over UDP and leave a bag; make the bags of flights that were cut off from their journals."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from firmware_model.errors import ConfigError
from firmware_model.recording.durable_file import is_growing
from firmware_model.recording.estimates import ATTITUDE_SUFFIX, read_estimates
from firmware_model.recording.journal import read_journal
from gustproof.errors import FlightError
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.recording.bag import UNFINISHED_PREFIX, write_bag
from gustproof.flight.recording.difference import first_difference
from gustproof.flight.routes.external import fly_external
from gustproof.flight.routes.flight import Flight, FlightPlan, flight_name, parse_metadata, parse_nominal
from gustproof.flight.routes.outcome import describe, infer_outcome
from gustproof.flight.routes.processes import WORKING_PREFIX, fly_plan


def fly_and_record(
    plan: FlightPlan,
    out: Path,
    *,
    tlog: bool = False,
    progress: Callable[[float], None] | None = None,
    on_listening: Callable[[int | None, Path], None] | None = None,
    on_flown: Callable[[], None] = lambda: None,
) -> Flight:
    """Fly a plan over UDP and leave its bag in the folder `out`, named for scenario, law and seed.

    `progress` and `on_listening` are those of `processes.fly`, or of `external.fly_external` for a real autopilot.
    `on_flown` is called before the bag is written, which takes seconds for an hour of flight. With `tlog` the MAVLink
    traffic is left beside the bag. The journal is removed once its bag is whole, or if it is empty.

    Raises
    ------
    ConfigError
        If the bag exists already, or the flight can't be started as requested.
    FlightError
        If the bag can't be written; the journal stays for `recover`.
    """
    fly = fly_external if isinstance(plan.controller, ExternalAutopilot) else fly_plan
    flight = fly(plan, out, tlog=tlog, progress=progress, on_listening=on_listening)
    on_flown()
    facts = {} if flight.autopilot is None else {"autopilot": flight.autopilot}
    return _replace_journal(flight, {**plan._replace(scenario=flight.scenario).metadata(), **facts})


def recover(folder: Path) -> list[Flight]:
    """Make the bags of flights that were cut off from the journals in `folder`; return the flights.

    A flight to the end of its script gives the same bag as if it had not been cut off.

    Raises
    ------
    ConfigError
        If there is no journal, a file is no journal, lacks what was flown or still grows, or its bag exists with other
        records.
    FlightError
        If a bag can't be written; its journal stays.
    """
    journals = sorted(folder.glob("*.journal"))
    if not journals:
        raise ConfigError(f"{folder}: no journal here: nothing to recover")
    for journal in journals:
        if is_growing(journal):
            raise ConfigError(f"{journal}: the flight is not over")
    for leftover in (*folder.glob(f"{UNFINISHED_PREFIX}*"), *folder.glob(f"{WORKING_PREFIX}*")):
        shutil.rmtree(leftover, ignore_errors=True)  # a link to elsewhere stays
    return [_recover(journal) for journal in journals]


def _recover(journal: Path) -> Flight:
    header, records = read_journal(journal, sound=True)
    metadata = header.get("note", {})
    scenario, controller, vehicle, seed, _ = parse_metadata(metadata, journal)
    outcome = infer_outcome(records, scenario)
    ended = f"{describe(outcome, scenario, records)}, {len(records)} of {scenario.samples} samples"
    flight = Flight(
        scenario=scenario, controller=controller, vehicle=vehicle, seed=seed, records=records, outcome=outcome,
        message="", journal=journal, nominal=parse_nominal(metadata, journal), autopilot=metadata.get("autopilot"),
        estimates=read_estimates(journal.with_suffix(ATTITUDE_SUFFIX)) if "autopilot" in metadata else None,
    )  # fmt: skip
    flight = replace(flight, message=f"{scenario.name}, {flight.pilot_name}, seed {seed}: {ended}")
    return _replace_journal(flight, metadata)


def _replace_journal(flight: Flight, metadata: Mapping[str, Any]) -> Flight:
    """Write the bag of a flight beside its journal, unless it is there already, and remove the journal."""
    journal, bag = flight.journal, None
    if journal is None:
        raise ValueError("the flight has no journal")
    if len(flight.records):
        bag = journal.parent / flight_name(flight.scenario, flight.pilot_name, flight.seed)
        try:
            # a writer that was killed before removing the journal has left the bag already
            if not (bag.exists() and first_difference(bag, flight.records) == (None, len(flight.records))):
                timing = {} if flight.timing is None else {"pace": dict(flight.timing)}
                about = {**metadata, "outcome": flight.outcome.name.lower(), **timing}
                judged = [result.to_dict() for result in flight.requirements]
                write_bag(bag, flight.records, about, flight.estimates, judged)
        except OSError as error:
            kept = f"what was flown is in {journal}: make room, then gustproof report {bag.parent}"
            raise FlightError(f"{bag}: {error.strerror}; {kept}") from None
    log = journal.with_suffix(".tlog")
    if bag is None and log.exists() and not log.stat().st_size:
        log.unlink()  # of a flight that ended before its first message
    journal.unlink(missing_ok=True)
    journal.with_suffix(ATTITUDE_SUFFIX).unlink(missing_ok=True)
    return replace(flight, bag=bag, journal=None)
