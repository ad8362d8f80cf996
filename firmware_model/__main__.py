"""`python -m firmware_model`: a simulated vehicle with its autopilot, on UDP."""

import argparse
import gc
import json
import signal
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model import udp
from firmware_model.autopilot import Mode
from firmware_model.endpoint import Outcome, VehicleEndpoint
from firmware_model.errors import ConfigError
from firmware_model.files import Parsed, parse
from firmware_model.frames import Peer
from firmware_model.journal import JournalWriter
from firmware_model.loop import VehicleLoop
from firmware_model.scenario import Scenario, load_scenario, shipped_scenarios
from firmware_model.signals import Level
from firmware_model.vehicle import Vehicle, load_vehicle, shipped_vehicles

# PX4's ports in simulation, so that its clients find us: (ours, theirs) for ground stations and for off-board control.
_PORTS = ((18570, 14550), (14580, 14540))
_EXIT = {Outcome.DONE: 0, Outcome.INTERRUPTED: 130}
_BROKEN = 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the vehicle until its scenario has ended; return the exit status."""
    options = _parser().parse_args(arguments)
    try:
        return _fly(options)
    except ConfigError as error:
        print(f"firmware_model: {error}", file=sys.stderr)
        return 2


def _fly(options: argparse.Namespace) -> int:
    scenario = _read(Scenario, options.scenario) or load_scenario(options.scenario)
    vehicle = _read(Vehicle, options.vehicle) or load_vehicle(options.vehicle)
    header = {"scenario": scenario.name, "vehicle": vehicle.name, "seed": options.seed}
    with ExitStack() as stack:
        ports = [pair[0] + options.instance for pair in _PORTS] if options.bind_port is None else [options.bind_port]
        sockets = [stack.enter_context(udp.bind(port)) for port in ports]
        record = stack.enter_context(_journal(options.journal, header)).append if options.journal else _no_record
        expected: list[Peer] = []
        if options.bind_port is None:
            expected = [(index, ("127.0.0.1", pair[1] + options.instance)) for index, pair in enumerate(_PORTS)]
        endpoint = VehicleEndpoint(
            vehicle,
            scenario,
            options.seed,
            record,
            lockstep=options.lockstep,
            system=options.instance + 1,
            expected=expected,
        )
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: endpoint.interrupt())
        # The machine code is loaded, or made, before anybody waits for it.
        VehicleLoop(vehicle, scenario, options.seed).advance(Level(), Mode.STABILIZED.value)
        # A flight leaves no cycles, and the collector's visits cost a sixth of it.
        gc.disable()
        _say(options, {"listening": [bound.getsockname()[1] for bound in sockets], **header})
        udp.serve(endpoint, sockets)
    _say(options, summary(endpoint, scenario.samples))
    return _EXIT.get(endpoint.outcome, _BROKEN) if endpoint.outcome else _BROKEN


def summary(endpoint: VehicleEndpoint, samples: int) -> dict[str, Any]:
    """Return what is to be said of a flight: outcome, samples flown, wall time from t = 0 to landing, counters."""
    flight = endpoint.flight
    flown_s = flight.wall_us * 1e-6
    counters = {cause.value: count for cause, count in sorted((flight.counters + endpoint.counters).items(), key=str)}
    return {
        "outcome": endpoint.outcome.value if endpoint.outcome else None,
        "samples": flight.loop.sample,
        "of": samples,
        "wall_s": flown_s,
        "realtime_factor": flight.loop.time_us * 1e-6 / flown_s if flown_s else 0.0,
        "counters": counters,
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="firmware_model",
        description="A simulated multirotor with its autopilot. Speaks MAVLink over UDP on this machine, as PX4's "
        "simulation does, and is not PX4. The vehicle is clamped until it is armed and in OFFBOARD; then the "
        "scenario is flown, and the process ends with it.",
        epilog="Exit status: 0 flown in OFFBOARD to the end, 2 bad input, 3 the flight broke off, 130 interrupted.",
    )
    add = parser.add_argument
    add("--scenario", default="calm", help=f"a .toml file, or one of {', '.join(shipped_scenarios())} [calm]")
    add("--vehicle", default="paper", help=f"a .toml file, or one of {', '.join(shipped_vehicles())} [paper]")
    add("--seed", type=int, default=1, help="seed of gusts and noise [1]")
    add("--lockstep", action="store_true", help="wait for the answer to each sample, as fast as it goes")
    add("--instance", type=int, default=0, help="number of this vehicle: added to all ports, system id N + 1 [0]")
    add("--bind-port", type=int, help="listen on this port alone, 0 for a free one [18570 and 14580]")
    add("--journal", type=Path, help="new file for the flight's records")
    add("--json", action="store_true", help="print JSON, one object a line")
    return parser


def _read(kind: type[Parsed], name: str) -> Parsed | None:
    """Return the content of a .json file, as another process of the project writes it; `None` if it is none."""
    path = Path(name)
    if path.suffix != ".json":
        return None
    try:
        return parse(kind, json.loads(path.read_text(encoding="utf-8")), name)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON: {error}") from None


def _journal(path: Path, header: dict[str, Any]) -> JournalWriter:
    try:
        return JournalWriter(path, header)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None


def _no_record(_: NDArray[np.float64]) -> None:
    pass


def _say(options: argparse.Namespace, facts: dict[str, Any]) -> None:
    text = json.dumps(facts) if options.json else "  ".join(f"{name} {value}" for name, value in facts.items())
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
