"""`python -m firmware_model`: a simulated vehicle with its autopilot, on UDP.

without --scenario   interactive vehicle: real time, disarmed, until Ctrl-C
--scenario           one scripted flight: clamped until a controller flies it, ends with the scenario
"""

import gc

if __name__ == "__main__":  # what is imported stays: to look for garbage in it takes a sixth of the start
    gc.disable()

import errno
import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from socket import socket
from typing import Any, Literal

from pydantic_core import to_jsonable_python

from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.files import parse_json, read_json, read_text
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.validation import printable
from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.errors import ConfigError, RecordingError
from firmware_model.process import access, realtime, status_line, udp
from firmware_model.process.exit_on_eof import exit_on_stdin_eof
from firmware_model.process.interrupts import call_on_interrupt
from firmware_model.process.tlog import Tlog
from firmware_model.process.words import read_words
from firmware_model.recording.journal import JournalWriter, record_type
from firmware_model.session.exchange import load_exchange
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.pacing import FlightClock, TimingFault
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.sim.vehicle_loop import is_cold, load_step

# PX4's ports in simulation, where its clients look: (own, remote) for ground stations and for off-board control.
_PORTS = ((18570, 14550), (14580, 14540))
_RANGES = {"instance": (0, 253), "seed": (0, 2**32 - 1)}  # system id is instance + 1; 255 is that of ground stations
_EXIT_STATUS: dict[VehicleOutcome | None, int] = {VehicleOutcome.DONE: 0, VehicleOutcome.INTERRUPTED: 130}
_EXIT_FAILED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleOptions:
    """Options of the simulated vehicle; `gustproof autopilot --help` tells what each does."""

    scenario: str | None = None
    """Script to fly, a name or a file; `None` for an interactive vehicle."""
    air: str | None = None
    """Scenario that gives wind and moments to an interactive vehicle."""
    held: bool = False
    """True for the test stand."""
    vehicle: str = "paper"
    """Name or file."""
    seed: int = 1
    """Seed of gusts and noise."""
    lockstep: bool = False
    """True to fly as fast as samples are answered."""
    instance: int = 0
    """Number that is added to all ports."""
    bind_port: int | None = None
    """Port of this side, 0 for a free one."""
    bind: str = access.LOOPBACK
    """Local address to listen on."""
    signing_key: Path | None = None
    """File with the key that signs every message; `none` to accept commands from anyone."""
    journal: Path | None = None
    """New file for the records of the flight."""
    metadata: Path | None = None
    """JSON file with the metadata for the journal's header, by a parent process."""
    tlog: Path | None = None
    """New telemetry log."""
    exit_on_stdin_eof: bool = False
    """True if a parent process holds the standard input open for as long as the flight shall last."""
    autopilot: Literal["px4", "generic"] = "px4"
    """Dialect of MAVLink."""
    params: bool = False
    """True to print all parameters, and end."""
    json: bool = False
    """True to print JSON, one object a line."""


def main(words: Sequence[str]) -> int:
    """Run the vehicle with the options in `words`; return the exit status."""
    try:
        return run(read_words(VehicleOptions, words))
    except (ConfigError, RecordingError) as error:
        print(f"firmware_model: {printable(str(error))}", file=sys.stderr)
        return 2 if isinstance(error, ConfigError) else _EXIT_FAILED


def run(options: VehicleOptions) -> int:
    """Run the vehicle until it is interrupted or its scenario has ended; return the exit status.

    Raises
    ------
    ConfigError
        If an option or a file is wrong.
    RecordingError
        If the recording can't be written.
    """
    _check_options(options)
    interactive, generic = _is_interactive(options), options.autopilot == "generic"
    scenario, vehicle = _load(options)
    if options.params:
        _print_parameters(options, Parameters(vehicle, scenario, bytewise=not generic))
        return 0
    return _fly(options, scenario, vehicle, interactive=interactive, generic=generic)


def _check_options(options: VehicleOptions) -> None:
    for name, (least, most) in _RANGES.items():
        if not least <= (value := getattr(options, name)) <= most:
            raise ConfigError(f"--{name} is {value}, must be {least} to {most}")
    if not _is_interactive(options) and (options.held or options.air):
        raise ConfigError("--held and --air need a vehicle without --scenario and --lockstep")


def _listen(port: int, host: str) -> socket:
    try:
        return udp.bind(port, host)
    except ConfigError as error:
        if getattr(error.__cause__, "errno", None) != errno.EADDRINUSE:
            raise
        advice = "end the other autopilot or real-time flight; `gustproof autopilot` also takes --instance, --bind-port"
        raise ConfigError(f"{error}: {advice}") from None


def _is_interactive(options: VehicleOptions) -> bool:
    return options.scenario is None and not options.lockstep


def _fly(options: VehicleOptions, scenario: Scenario, vehicle: Vehicle, *, interactive: bool, generic: bool) -> int:
    with ExitStack() as stack:
        host, _ = udp.resolve(options.bind, 0)
        signing = access.make_signing(host, options.signing_key)
        ports, remote_ports = _choose_ports(options)
        sockets = [stack.enter_context(_listen(port, host)) for port in ports]
        journal = _open_journal(stack, options, scenario, vehicle)
        endpoint = VehicleEndpoint(
            vehicle,
            scenario,
            options.seed,
            journal.append if journal else lambda _: None,
            lockstep=options.lockstep,
            interactive=interactive,
            system=options.instance + 1,
            expected=[(index, ("127.0.0.1", port)) for index, port in enumerate(remote_ports)],
            signing=signing,
            generic=generic,
        )
        if journal:
            endpoint.flush = journal.flush
        served = _open_tlog(stack, options, endpoint)
        call_on_interrupt(endpoint.interrupt)
        # Load or compile the machine code before a peer waits for it.
        _tell_compiling(silent=options.json or not interactive)
        load_step(vehicle, scenario, options.seed)
        if endpoint.exchanges:
            load_exchange(endpoint.loop)
        realtime.freeze_gc(off=not interactive)
        _announce(options, _names(options, scenario, vehicle), sockets, remote_ports)
        _show_status(stack, options, endpoint)
        if options.exit_on_stdin_eof:
            exit_on_stdin_eof(endpoint.interrupt)
        fifo = not options.lockstep and realtime.request_fifo_scheduling()
        _serve(served, sockets, lockstep=options.lockstep)
    facts = summarize(endpoint, None if interactive else scenario.samples, fifo=fifo)
    _print_facts(options, facts, status_line.format_summary(facts))
    return _EXIT_STATUS.get(endpoint.outcome, _EXIT_FAILED)


def _tell_compiling(*, silent: bool) -> None:
    if not silent and is_cold():
        print("compiling, once after an installation", file=sys.stderr, flush=True)


def _load(options: VehicleOptions) -> tuple[Scenario, Vehicle]:
    name = options.scenario or options.air or "calm"
    scenario = read_json(Scenario, name) or load_scenario(name)
    if _is_interactive(options):
        scenario = replace(scenario, translation="held" if options.held else "free")
    return scenario, read_json(Vehicle, options.vehicle) or load_vehicle(options.vehicle)


def _choose_ports(options: VehicleOptions) -> tuple[list[int], list[int]]:
    """Return the local ports, and the remote ports that receive data unasked."""
    if options.bind_port is not None:
        return [options.bind_port], []
    return [own + options.instance for own, _ in _PORTS], [remote + options.instance for _, remote in _PORTS]


def _serve(endpoint: VehicleEndpoint | Tlog, sockets: Sequence[socket], *, lockstep: bool) -> None:
    if lockstep and len(sockets) == 1:
        udp.serve_lockstep(endpoint, sockets[0], endpoint.exchange)
    else:
        udp.serve(endpoint, sockets, real_time=not lockstep)


def _announce(
    options: VehicleOptions, names: dict[str, Any], sockets: Sequence[socket], remote_ports: Sequence[int]
) -> None:
    """Print vehicle, scenario and ports; for users of an interactive vehicle, also how to connect clients."""
    listening = [bound.getsockname()[1] for bound in sockets]
    if _is_interactive(options) and not options.json:
        place = "on the test stand" if options.held else "on the ground"
        headline = f"vehicle '{names['vehicle']}' {place} in the air of '{names['scenario']}'"
        print(format_greeting(headline, listening, remote_ports), flush=True)
    else:
        script = ", ".join(f"{name} {value}" for name, value in names.items())
        text = f"{script}; listening on UDP port {', '.join(map(str, listening))}"
        _print_facts(options, {"listening": listening, **names}, text)


def format_greeting(headline: str, listening: Sequence[int], remote_ports: Sequence[int]) -> str:
    """Return the headline and the connection of each client; `remote_ports` receive data unasked, if there are any."""
    own = f"127.0.0.1:{listening[-1]}"
    ground, sdk = f"a UDP link with server address {own}", f"udpout://{own}"
    proxy = library = f"udpout:{own}"
    if remote_ports:
        unasked, offboard = remote_ports
        ground, sdk = f"finds it by itself (UDP port {unasked})", f"udpin://0.0.0.0:{offboard}"
        proxy, library = f"udp:127.0.0.1:{unasked}", f"udpin:127.0.0.1:{unasked}"
    ways = {
        "QGroundControl": ground,
        "MAVProxy": f"mavproxy.py --master {proxy}",
        "MAVSDK": sdk,
        "pymavlink": f'mavutil.mavlink_connection("{library}")',
        "a law": f"gustproof controller --law flagship --connect {own}",
    }
    lines = [f"  {client:<15} {way}" for client, way in ways.items()]
    first = f"{headline}, disarmed; its MAVLink is like that of PX4, but it is not PX4"
    return "\n".join((first, *lines, "Ctrl-C ends it."))


def summarize(endpoint: VehicleEndpoint, samples: int | None, *, fifo: bool = False) -> dict[str, Any]:
    """Return the facts of a run: outcome, samples flown, wall time from t = 0, timing, counters, links.

    `fifo` is True if the process ran with SCHED_FIFO.
    """
    flight = endpoint.flight
    flown_s = flight.wall_us * 1e-6
    counters = {cause.value: count for cause, count in sorted((flight.counters + endpoint.counters).items(), key=str)}
    return {
        "outcome": endpoint.outcome.value if endpoint.outcome else None,
        "samples": flight.loop.sample,
        "of": samples,
        "wall_s": flown_s,
        "slipped_s": flight.slipped_us * 1e-6,
        "realtime_factor": flight.loop.time_us * 1e-6 / flown_s if flown_s else 0.0,
        "pace": None if flight.lockstep else _summarize_timing(flight, fifo),
        "counters": counters,
        "state": _describe_state(endpoint),
        "links": endpoint.links,
        "link_faults": endpoint.scripted_link.stats() if endpoint.scripted_link else {},
    }


def _describe_state(endpoint: VehicleEndpoint) -> dict[str, Any]:
    """Return the state at the end: for a flight that did not begin, how far its controller came."""
    autopilot = endpoint.autopilot
    return {"armed": autopilot.armed, "mode": autopilot.mode.name, "answered": endpoint.flight.setpoint is not None}


_PACE_COUNTERS = {"missed": TimingFault.OVERRUN, "held": TimingFault.HELD, "stalled": TimingFault.STALLED}


def _summarize_timing(flight: FlightClock, fifo: bool) -> dict[str, Any]:
    """Return the delays of the samples; `TimingFault.OVERRUN` defines a missed deadline."""
    late = {f"late_{name}": value for name, value in flight.latency.stats().items()}
    counts = {name: flight.counters[fault] for name, fault in _PACE_COUNTERS.items()}
    return {**counts, **late, "fifo": fifo}


def _show_status(stack: ExitStack, options: VehicleOptions, endpoint: VehicleEndpoint) -> None:
    if _is_interactive(options) and not options.json and sys.stderr.isatty():
        stack.enter_context(status_line.show_status_line(lambda: endpoint.links))


def _names(options: VehicleOptions, scenario: Scenario, vehicle: Vehicle) -> dict[str, Any]:
    return {"scenario": scenario.name, "vehicle": vehicle.name, "seed": options.seed}


def _open_journal(
    stack: ExitStack, options: VehicleOptions, scenario: Scenario, vehicle: Vehicle
) -> JournalWriter | None:
    if options.journal is None:
        return None
    header = names = _names(options, scenario, vehicle)
    try:
        if options.metadata:
            header = {**names, "note": parse_json(read_text(options.metadata))}
        elif not _is_interactive(options):  # the law is not known here
            note = {**names, "scenario": scenario, "vehicle": vehicle, "law": None, "real_time": not options.lockstep}
            header = {**names, "note": to_jsonable_python(note)}
        record = record_type(vehicle.rotors.count)
        writer = JournalWriter(options.journal, header, scenario.control_rate_hz, record)
    except OSError as error:
        raise ConfigError(f"{error.filename}: {error.strerror}") from None
    return stack.enter_context(writer)


def _open_tlog(stack: ExitStack, options: VehicleOptions, endpoint: VehicleEndpoint) -> VehicleEndpoint | Tlog:
    if options.tlog is None:
        return endpoint
    unix_us, flight = udp.unix_us(), endpoint.flight

    def stamp_us(now_us: int) -> int:
        return unix_us + (flight.clock_us(now_us) if flight.lockstep else now_us)

    try:
        return stack.enter_context(Tlog(options.tlog, endpoint, stamp_us, endpoint.exchange))
    except OSError as error:
        raise ConfigError(f"{options.tlog}: {error.strerror}") from None


def _print_parameters(options: VehicleOptions, parameters: Parameters) -> None:
    for row in parameters.describe():
        if options.json:
            print(json.dumps(row))
        else:
            value = f"{row['default']} {row['unit']}".rstrip()
            print(f"{row['name']:<17} {row['type']:<7} {value:<16} {row['allowed']:<16} {row['meaning']}")


def _print_facts(options: VehicleOptions, facts: dict[str, Any], text: str) -> None:
    print(json.dumps(to_jsonable_python(facts, inf_nan_mode="null")) if options.json else text, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
