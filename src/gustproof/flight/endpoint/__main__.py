"""`python -m gustproof.flight.endpoint`: fly a law file, or a user's controller, against an autopilot over MAVLink."""

import gc

if __name__ == "__main__":  # what is imported stays: to look for garbage in it takes a sixth of the start
    gc.disable()

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Literal

from firmware_model.config.files import read_json
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.validation import printable
from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.process import access, realtime
from firmware_model.process.exit_on_eof import exit_on_stdin_eof
from firmware_model.process.interrupts import call_on_interrupt
from firmware_model.process.words import read_words
from gustproof.flight.controllers.stepper import CheckedStepper, make_stepper
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.endpoint import DEFAULT_LAW, connection
from gustproof.flight.endpoint.core import Flown
from gustproof.flight.endpoint.endpoint import ControllerEndpoint, ControllerOutcome
from gustproof.flight.endpoint.exchange import load_exchange
from gustproof.law.form import Law, Output, load_law
from gustproof.law.step import LawStepper, is_cold

_EXIT = {
    ControllerOutcome.DONE: 0,
    ControllerOutcome.WRONG_RATE: 2,
    ControllerOutcome.NOT_SUPPORTED: 2,
    ControllerOutcome.INTERRUPTED: 130,
}
_EXIT_BROKEN_OFF = 3
_DEFAULT_DT = 0.004
"""[s] sample time of an object of Python without scenario."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerOptions:
    """Options of the controller; `gustproof controller --help` tells what each does."""

    law: str = DEFAULT_LAW
    """Name or file of the law."""
    controller: str | None = None
    """Source of a controller that is flown instead."""
    vehicle: str = "paper"
    """Nominal vehicle that a controller's maker gets, a name or a file."""
    via: Literal["torque", "rates"] | None = None
    """Message for the command; `None` for the law's output."""
    connect: str = "127.0.0.1:14580"
    """Address of the autopilot."""
    bind_port: int | None = None
    """Port of this side, 0 for a free one."""
    signing_key: Path | None = None
    """File with the key that signs every message; `none` to accept commands from anyone."""
    height: Literal["hold", "free"] = "hold"
    """Thrust beside rates, once a pilot has flown."""
    attitude: Literal["autopilot", "own"] = "autopilot"
    """Attitude of a law with an estimate, once a pilot has flown."""
    scenario: str | None = None
    """Script with the references to hold; `None` for level."""
    real_time: bool = False
    """True to request real-time scheduling."""
    exit_on_stdin_eof: bool = False
    """True if a parent process holds the standard input open for as long as the flight shall last."""
    json: bool = False
    """True to print JSON, one object a line."""


def main(words: Sequence[str]) -> int:
    """Run the controller with the options in `words`; return the exit status."""
    try:
        return run(read_words(ControllerOptions, words))
    except ConfigError as error:
        _report(str(error))
        return 2


def run(options: ControllerOptions) -> int:
    """Run the controller until the flight has ended; return the exit status.

    Raises
    ------
    ConfigError
        If an option or a file is wrong.
    """
    with _prints_apart(options):
        law = _make_entry(options.controller, options) if options.controller else load_law(options.law)
    if options.via is not None and Output(options.via) is not law.output:
        raise ConfigError(f"law '{law.name}' commands {law.output.value}, it can't fly via {options.via}")
    return _fly(law, options)


def _make_entry(source: str, options: ControllerOptions) -> CheckedStepper:
    """Make the controller of a user's file, at the rate of the scenario."""
    script, vehicle = _read_scenario(options), read_json(Vehicle, options.vehicle) or load_vehicle(options.vehicle)
    return make_stepper(parse_controller(source), vehicle, _DEFAULT_DT if script is None else script.dt)


@contextmanager
def _prints_apart(options: ControllerOptions) -> Iterator[None]:
    """Write what a user's controller prints to a file that is removed, if a parent reads the output of this process.

    Nobody reads a pipe in flight: a full one would stop the controller.
    """
    if not (options.controller and options.exit_on_stdin_eof):
        yield
        return
    streams = sys.stdout, sys.stderr
    kept = [os.dup(stream.fileno()) for stream in streams]
    with TemporaryFile() as printed:
        for stream in streams:
            os.dup2(printed.fileno(), stream.fileno())
        try:
            yield
        finally:
            for stream, own in zip(streams, kept, strict=True):
                stream.flush()
                os.dup2(own, stream.fileno())
                os.close(own)


def _read_scenario(options: ControllerOptions) -> Scenario | None:
    name = options.scenario
    return read_json(Scenario, name) or load_scenario(name) if name else None


def _load(law: Law, *, exchanges: bool) -> bool:
    """Load or compile the machine code before the flight, and return whether that of the exchange is there."""
    stepper = LawStepper(law, (1.0, 1.0, 1.0))
    stepper.step((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    if exchanges:
        load_exchange(stepper.packed)
    return exchanges


def _fly(law: Flown, options: ControllerOptions) -> int:
    report: Callable[[str], None] = (lambda _: None) if options.json or options.exit_on_stdin_eof else _report
    if options.connect != "-":
        connection.parse_target(options.connect)  # refused before anything is compiled
    if is_cold():
        report("compiling, once after an installation")
    is_loaded = isinstance(law, Law) and _load(law, exchanges=not options.real_time)
    realtime.freeze_gc(off=True)
    script = _read_scenario(options)
    references = () if script is None else script.references
    target = connection.parse_target(options.connect)
    signing = access.make_signing(target.address[0], options.signing_key, strict=True)
    endpoint = ControllerEndpoint(
        law,
        (0, target.address),
        signing,
        references,
        report,
        hold_height=options.height == "hold",
        correct_attitude=options.attitude == "autopilot",
    )
    call_on_interrupt(endpoint.interrupt)
    if options.exit_on_stdin_eof:
        exit_on_stdin_eof(endpoint.interrupt)
    if options.real_time:
        realtime.request_fifo_scheduling()
    with _prints_apart(options):
        connection.serve(endpoint, target, options.bind_port, report, is_loaded=is_loaded)
    outcome = endpoint.outcome or ControllerOutcome.INTERRUPTED
    _print_summary(law, endpoint, outcome, as_json=options.json)
    return _EXIT.get(outcome, _EXIT_BROKEN_OFF)


def _print_summary(law: Flown, endpoint: ControllerEndpoint, outcome: ControllerOutcome, *, as_json: bool) -> None:
    if as_json:
        counters = {cause.value: count for cause, count in endpoint.channel.dropped.items()}
        summary = {"outcome": outcome.value, "message": endpoint.message, "counters": counters}
        samples_lost = {"late_samples": endpoint.late, "missed_samples": endpoint.missed}
        print(json.dumps({**summary, **samples_lost, "link": endpoint.channel.stats()}))
        return
    samples = f"{endpoint.late} samples late, {endpoint.missed} missed"
    if outcome is ControllerOutcome.DONE:
        print(f"law '{law.name}': flown to the end, {samples}")
    else:
        _report(f"{endpoint.message}{f'; {samples}' if endpoint.late or endpoint.missed else ''}")


def _report(text: str) -> None:
    print(f"gustproof controller: {printable(text)}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
