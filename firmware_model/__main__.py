"""`python -m firmware_model`: a simulated vehicle with its autopilot, on UDP.

without --scenario   a standing vehicle: real time, disarmed, until Ctrl-C
--scenario           one scripted flight: clamped until a controller flies it, ends with the scenario
"""

import argparse
import json
import signal
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from firmware_model.autopilot.modes import Mode
from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.files import parse_json, read_json, read_text
from firmware_model.config.scenario import Scenario, list_scenarios, load_scenario
from firmware_model.config.validation import Parser, printable
from firmware_model.config.vehicle import Vehicle, list_vehicles, load_vehicle
from firmware_model.errors import ConfigError, RecordingError
from firmware_model.mavlink.frames import Address
from firmware_model.process import access, realtime, status_line, udp
from firmware_model.process.exit_on_eof import EXIT_ON_STDIN_EOF, exit_on_stdin_eof
from firmware_model.process.tlog import Tlog
from firmware_model.recording.journal import JournalWriter
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.pacing import FlightClock, TimingFault
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import LevelFlight

# PX4's ports in simulation, so that its clients find us: (ours, theirs) for ground stations and for off-board control.
_PORTS = ((18570, 14550), (14580, 14540))
_RANGES = {"instance": (0, 253), "seed": (0, 2**32 - 1)}  # the system id is one more; 255 is that of ground stations
_EXIT_STATUS = {VehicleOutcome.DONE: 0, VehicleOutcome.INTERRUPTED: 130}
_EXIT_FAILED = 3


def main(arguments: Sequence[str] | None = None, *, program: str = "firmware_model") -> int:
    """Run the vehicle until it is interrupted, or its scenario has ended; return the exit status.

    `program` is the name that help and errors begin with.
    """
    options = _make_parser(program).parse_args(arguments)
    standing = options.scenario is None and not options.lockstep
    try:
        for name, (least, most) in _RANGES.items():
            if not least <= (value := getattr(options, name)) <= most:
                raise ConfigError(f"--{name} is {value}, must be {least} to {most}")
        if not standing and (options.held or options.air):
            raise ConfigError("--held and --air are for a vehicle without --scenario and --lockstep")
        return _run(options, standing)
    except ConfigError as error:
        print(f"{program}: {printable(str(error))}", file=sys.stderr)
        return 2
    except RecordingError as error:
        print(f"{program}: {printable(str(error))}", file=sys.stderr)
        return _EXIT_FAILED


def _run(options: argparse.Namespace, standing: bool) -> int:
    name = options.scenario or options.air or "calm"
    scenario = read_json(Scenario, name) or load_scenario(name)
    if standing:
        scenario = replace(scenario, translation="held" if options.held else "free")
    vehicle = read_json(Vehicle, options.vehicle) or load_vehicle(options.vehicle)
    generic = options.autopilot == "generic"
    if options.params:
        _print_parameters(options, Parameters(vehicle, scenario, bytewise=not generic))
        return 0
    header = {"scenario": scenario.name, "vehicle": vehicle.name, "seed": options.seed}
    with ExitStack() as stack:
        ports = [pair[0] + options.instance for pair in _PORTS] if options.bind_port is None else [options.bind_port]
        host, _ = udp.resolve(options.bind, 0)
        signing = access.make_signing(options, host)
        sockets = [stack.enter_context(udp.bind(port, host)) for port in ports]
        journal = (
            _open_journal(stack, options, _heading(options, scenario, vehicle), scenario) if options.journal else None
        )
        expected: list[Address] = []
        if options.bind_port is None:
            expected = [(index, ("127.0.0.1", pair[1] + options.instance)) for index, pair in enumerate(_PORTS)]
        endpoint = VehicleEndpoint(
            vehicle,
            scenario,
            options.seed,
            journal.append if journal else _discard_record,
            lockstep=options.lockstep,
            interactive=standing,
            system=options.instance + 1,
            expected=expected,
            signing=signing,
            generic=generic,
        )
        if journal:
            endpoint.flush = journal.flush
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: endpoint.interrupt())
        # The machine code is loaded, or made, before anybody waits for it.
        VehicleLoop(vehicle, scenario, options.seed).advance(LevelFlight(), Mode.STABILIZED.value)
        realtime.freeze_gc(off=not standing)
        listening = [bound.getsockname()[1] for bound in sockets]
        if standing and not options.json:
            place = "on the test stand" if options.held else "on the ground"
            stands = f"vehicle '{vehicle.name}' {place} in the air of '{scenario.name}'"
            print(format_greeting(stands, listening, [peer[1][1] for peer in expected]), flush=True)
            if sys.stderr.isatty():
                stack.enter_context(status_line.show_status_line(lambda: endpoint.links))
        else:
            script = ", ".join(f"{name} {value}" for name, value in header.items())
            ears = ", ".join(map(str, listening))
            _print_facts(options, {"listening": listening, **header}, f"{script}; listening on UDP port {ears}")
        if options.exit_on_stdin_eof:
            exit_on_stdin_eof(endpoint.interrupt)
        fifo = not options.lockstep and realtime.request_fifo_scheduling()
        served = _open_tlog(stack, options, endpoint) if options.tlog else endpoint
        if options.lockstep and len(sockets) == 1:
            udp.serve_lockstep(served, sockets[0])
        else:
            udp.serve(served, sockets, real_time=not options.lockstep)
    facts = summarize(endpoint, None if standing else scenario.samples, fifo=fifo)
    _print_facts(options, facts, status_line.ending(facts))
    return _EXIT_STATUS.get(endpoint.outcome, _EXIT_FAILED) if endpoint.outcome else _EXIT_FAILED


def format_greeting(stands: str, listening: Sequence[int], told: Sequence[int]) -> str:
    """Return what stands there and how to connect to it; `told` are the ports that it speaks to unasked, if any."""
    if told:
        ground, offboard = told
        ways = {
            "QGroundControl": f"finds it by itself (UDP port {ground})",
            "MAVProxy": f"mavproxy.py --master udp:127.0.0.1:{ground}",
            "MAVSDK": f"udpin://0.0.0.0:{offboard}",
            "pymavlink": f'mavutil.mavlink_connection("udpin:127.0.0.1:{ground}")',
        }
    else:
        ways = {
            "QGroundControl": f"a UDP link with server address 127.0.0.1:{listening[-1]}",
            "MAVProxy": f"mavproxy.py --master udpout:127.0.0.1:{listening[-1]}",
            "MAVSDK": f"udpout://127.0.0.1:{listening[-1]}",
            "pymavlink": f'mavutil.mavlink_connection("udpout:127.0.0.1:{listening[-1]}")',
        }
    ways["a law"] = f"gustproof controller --law hinf-scheduled --connect 127.0.0.1:{listening[-1]}"
    return "\n".join(
        (
            f"{stands}, disarmed; speaks MAVLink as PX4 does, and is not PX4",
            *(f"  {client:<15} {way}" for client, way in ways.items()),
            "Ctrl-C ends it.",
        )
    )


def summarize(endpoint: VehicleEndpoint, samples: int | None, *, fifo: bool = False) -> dict[str, Any]:
    """Return what is to be said in the end: outcome, samples flown, wall time from t = 0, pace, counters, links.

    `fifo` says whether the system ran the process before usual ones.
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
        "links": endpoint.links,
        "link_faults": endpoint.scripted_link.stats() if endpoint.scripted_link else {},
    }


def _summarize_timing(flight: FlightClock, fifo: bool) -> dict[str, Any]:
    """Return how well the samples were flown on time: what a missed deadline is, `Hitch.OVERRUN` says."""
    late = {f"late_{name}": value for name, value in flight.latency.stats().items()}
    return {
        "missed": flight.counters[TimingFault.OVERRUN],
        "held": flight.counters[TimingFault.HELD],
        **late,
        "fifo": fifo,
    }


def _make_parser(program: str) -> argparse.ArgumentParser:
    parser = Parser(
        prog=program,
        description="A simulated multirotor with its autopilot. Speaks MAVLink over UDP on this machine, as PX4's "
        "simulation does, and is not PX4. It stands on the ground in real time until Ctrl-C. With --scenario it is "
        "clamped until it is armed and in OFFBOARD; then the scenario is flown, and the process ends with it.",
        epilog="Exit status: 0 flown in OFFBOARD to the end, 2 bad input, 3 the flight broke off, 130 interrupted.",
    )
    add = parser.add_argument
    shipped = f"a .toml file, or one of {', '.join(list_scenarios())}"
    add("--scenario", help=f"fly this script and end: {shipped}")
    add("--air", help=f"scenario in whose air the vehicle stands, from the start on: {shipped} [calm]")
    add("--held", action="store_true", help="hold the vehicle in its place, free in attitude while armed: a test stand")
    add("--vehicle", default="paper", help=f"a .toml file, or one of {', '.join(list_vehicles())} [paper]")
    add("--seed", type=int, default=1, help="seed of gusts and noise [1]")
    add("--lockstep", action="store_true", help="fly the script, by default calm, as fast as its samples are answered")
    add(
        "--instance",
        type=int,
        default=0,
        help="number of this vehicle, 0 to 253: added to all ports, system id N + 1 [0]",
    )
    add("--bind-port", type=int, help="listen on this port alone, 0 for a free one [18570 and 14580]")
    add(
        "--bind",
        default=access.LOOPBACK,
        metavar="HOST",
        help="address to be reached at, 0.0.0.0 for all [%(default)s]",
    )
    access.add_options(parser)
    add("--journal", type=Path, help="new file for the flight's records")
    add("--note", type=Path, help="JSON file whose content heads the journal: all that a recording of the flight says")
    add("--tlog", type=Path, help="new file for the MAVLink traffic, which ground stations open")
    add("--exit-on-stdin-eof", action="store_true", help=EXIT_ON_STDIN_EOF)
    add("--autopilot", choices=("px4", "generic"), default="px4", help="whose MAVLink it speaks [%(default)s]")
    add("--params", action="store_true", help="print all parameters with units, ranges and meanings, and end")
    add("--json", action="store_true", help="print JSON, one object a line")
    return parser


def _heading(options: argparse.Namespace, scenario: Scenario, vehicle: Vehicle) -> dict[str, Any]:
    """Return what heads a journal: of a scripted flight all but the law, as who flies is not known here."""
    names = {"scenario": scenario.name, "vehicle": vehicle.name, "seed": options.seed}
    if options.scenario is None and not options.lockstep:
        return names
    flown = {**names, "scenario": scenario, "vehicle": vehicle, "law": None, "real_time": not options.lockstep}
    return {**names, "note": to_jsonable_python(flown)}


def _open_journal(
    stack: ExitStack, options: argparse.Namespace, header: dict[str, Any], scenario: Scenario
) -> JournalWriter:
    try:
        note = {"note": parse_json(read_text(options.note))} if options.note else {}
        writer = JournalWriter(options.journal, {**header, **note}, scenario.control_rate_hz)
    except OSError as error:
        raise ConfigError(f"{error.filename}: {error.strerror}") from None
    return stack.enter_context(writer)


def _open_tlog(stack: ExitStack, options: argparse.Namespace, endpoint: VehicleEndpoint) -> udp.Endpoint:
    unix_us = udp.unix_us()
    flight = endpoint.flight
    try:
        log = Tlog(
            options.tlog, endpoint, lambda now_us: unix_us + (flight.clock_us(now_us) if flight.lockstep else now_us)
        )
    except OSError as error:
        raise ConfigError(f"{options.tlog}: {error.strerror}") from None
    return stack.enter_context(log)


def _print_parameters(options: argparse.Namespace, parameters: Parameters) -> None:
    for row in parameters.reference():
        if options.json:
            print(json.dumps(row))
        else:
            value = f"{row['default']} {row['unit']}".rstrip()
            print(f"{row['name']:<17} {row['type']:<7} {value:<16} {row['allowed']:<16} {row['meaning']}")


def _discard_record(_: NDArray[np.float64]) -> None:
    pass


def _print_facts(options: argparse.Namespace, facts: dict[str, Any], text: str) -> None:
    print(json.dumps(facts) if options.json else text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
