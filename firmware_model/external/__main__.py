"""`python -m firmware_model.external`: a scripted flight of a real autopilot, which this process starts and ends.

It prints one line of JSON when the autopilot is about to start, and one with the facts of the flight at its end.
"""

import contextlib
import json
import math
import select
import socket
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

from firmware_model.autopilot.modes import Mode
from firmware_model.config.files import parse_json, read_json, read_text
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.validation import printable
from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.errors import ConfigError, RecordingError
from firmware_model.external.client import ExternalClient
from firmware_model.external.flight import ExternalFlight
from firmware_model.external.interface import ExternalError, ExternalOptions, ExternalOutcome, ExternalProcess
from firmware_model.external.world import World
from firmware_model.mavlink.wire import LARGEST_DATAGRAM
from firmware_model.process import realtime, udp
from firmware_model.process.exit_on_eof import exit_on_stdin_eof
from firmware_model.process.interrupts import call_on_interrupt
from firmware_model.process.tlog import Tlog
from firmware_model.process.words import read_words
from firmware_model.recording.estimates import ATTITUDE_SUFFIX, EstimateWriter
from firmware_model.recording.journal import JournalWriter
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import LevelFlight

_EXIT_FAILED, _EXIT_BAD_INPUT = 3, 2
_COMMAND_WAITS = 20
_DATAGRAMS = 1000  # of one exchange at most; a flood must not stop the flight


def main(words: Sequence[str]) -> int:
    """Fly one scenario and return the exit status."""
    try:
        options = read_words(ExternalOptions, words)
        scenario = read_json(Scenario, options.scenario) or load_scenario(options.scenario)
        vehicle = read_json(Vehicle, options.vehicle) or load_vehicle(options.vehicle)
        facts = _fly(options, scenario, vehicle)
    except (ConfigError, RecordingError) as error:
        print(f"external: {printable(str(error))}", file=sys.stderr)
        return _EXIT_BAD_INPUT if isinstance(error, ConfigError) else _EXIT_FAILED
    print(json.dumps(facts), flush=True)
    return 0 if facts["outcome"] == ExternalOutcome.DONE.value else _EXIT_FAILED


def make_external(options: ExternalOptions, scenario: Scenario, vehicle: Vehicle) -> ExternalProcess:
    """Return the autopilot that the command line names, not started.

    Raises
    ------
    ConfigError
        If an option is wrong.
    """
    if options.autopilot == "betaflight":
        from firmware_model.external.betaflight_process import make_betaflight

        return make_betaflight(options, scenario, vehicle)
    if options.autopilot == "ardupilot":
        from firmware_model.external.ardupilot_process import make_ardupilot

        return make_ardupilot(options, scenario, vehicle)
    from firmware_model.external.px4_process import make_px4

    return make_px4(options, scenario, vehicle)


def _fly(options: ExternalOptions, scenario: Scenario, vehicle: Vehicle) -> dict[str, Any]:
    with ExitStack() as stack:
        external = make_external(options, scenario, vehicle)
        stack.callback(external.close)
        note = parse_json(read_text(options.metadata)) if options.metadata else {}
        names = {"scenario": scenario.name, "vehicle": vehicle.name, "seed": options.seed}
        try:
            journal = JournalWriter(options.journal, {**names, "note": note}, scenario.control_rate_hz)
            estimates = stack.enter_context(EstimateWriter(options.journal.with_suffix(ATTITUDE_SUFFIX)))
        except OSError as error:
            raise ConfigError(f"{error.filename}: {error.strerror}") from None
        stack.enter_context(journal)
        bound = stack.enter_context(udp.bind(0))
        world = World(vehicle, scenario, options.seed, journal.append)
        client = external.make_client()
        endpoint: udp.Endpoint = client
        if options.tlog:
            unix_us = time.time_ns() // 1000
            endpoint = stack.enter_context(Tlog(options.tlog, client, lambda now_us: unix_us + now_us))
        flight = ExternalFlight(
            external,
            client,
            world,
            vehicle,
            scenario,
            exchange=_exchanger(endpoint, bound, 0.0 if options.real_time else external.arrival_s, client),
            estimate=estimates.append_estimate,
            wait=_pacer() if options.real_time else lambda _: None,
        )
        call_on_interrupt(flight.interrupt)
        if options.exit_on_stdin_eof:
            exit_on_stdin_eof(flight.interrupt)
        # Load or compile the machine code before the autopilot waits for it.
        VehicleLoop(vehicle, scenario, options.seed).advance(LevelFlight(), Mode.STABILIZED.value)
        realtime.freeze_gc(off=True)
        print(json.dumps({"listening": bound.getsockname()[1], **names}), flush=True)
        outcome, reason, flown_s = _run(external, client, flight, bound.getsockname()[1])
        model_s = world.loop.time_us * 1e-6
        world.record_preparation()
        return {
            "outcome": outcome.value,
            "reason": reason,
            "samples": world.loop.sample if world.flying else 0,
            "wall_s": flown_s if world.flying else 0.0,
            "realtime_factor": model_s / flown_s if world.flying else 0.0,
            "autopilot": {
                "program": external.name,
                "version": client.version,
                **external.facts(),
                "unknown_parameters": client.reader.unknown,
                "rounded_parameters": client.reader.rounded,
                "read_back": client.reader.reported,
            },
            "texts": list(client.texts),
            "link": client.channel.stats(),
        }


def _run(
    external: ExternalProcess, client: ExternalClient, flight: ExternalFlight, port: int
) -> tuple[ExternalOutcome, str, float]:
    """Return outcome, reason, and wall time [s] of the scenario."""
    began_s = math.nan
    outcome, reason = ExternalOutcome.DONE, ""
    try:
        external.start(port)
        client.meet(external.system, external.client_port)
        flight.prepare()
        began_s = time.monotonic()
        flight.fly()
    except ExternalError as error:
        outcome, reason = error.outcome, printable(str(error))
    return outcome, reason, time.monotonic() - began_s


def _exchanger(
    endpoint: udp.Endpoint, bound: socket.socket, wait_s: float, client: ExternalClient
) -> Callable[[int, bool], None]:
    """Return the function that passes on all waiting datagrams, and sends those that are due.

    It can wait `wait_s` [s] before and after, for what is on its way; otherwise it waits for the client's echo.
    """

    def exchange(now_us: int, waits: bool) -> None:
        if waits and wait_s:
            time.sleep(wait_s)
        _receive(endpoint, bound, now_us)
        sent = endpoint.poll(now_us)
        for datagram, (_, peer) in sent:
            with contextlib.suppress(OSError):
                bound.sendto(datagram, peer)
        if waits and wait_s:  # a command wakes several threads of the autopilot, a set-point one
            time.sleep(wait_s if len(sent) < 2 else _COMMAND_WAITS * wait_s)
        if client.awaits_echo:
            until_s = time.monotonic() + _COMMAND_WAITS * wait_s
            while client.awaits_echo and select.select([bound], [], [], max(until_s - time.monotonic(), 0.0))[0]:
                _receive(endpoint, bound, now_us)

    return exchange


def _receive(endpoint: udp.Endpoint, bound: socket.socket, now_us: int) -> None:
    """Pass on all waiting datagrams."""
    for _ in range(_DATAGRAMS):
        try:
            datagram, address = bound.recvfrom(LARGEST_DATAGRAM)
        except BlockingIOError:
            break
        except OSError:  # an ICMP error for an earlier datagram
            continue
        endpoint.receive(datagram, (0, address), now_us)


def _pacer() -> Callable[[int], None]:
    """Return the function that waits until the clock has reached a sample, counted from its first call."""
    start_s: float | None = None

    def wait(time_us: int) -> None:
        nonlocal start_s
        now_s = time.monotonic()
        start_s = now_s - time_us * 1e-6 if start_s is None else start_s
        time.sleep(max(start_s + time_us * 1e-6 - now_s, 0.0))

    return wait


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
