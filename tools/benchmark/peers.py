"""Speed of other simulators, each in an environment of its own under .venv that is made once."""

import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from flights import CORES, fleet, scenario
from peer import PeerError, Program, environment
from table import Bench

from firmware_model.config.scenario import Scenario
from gustproof.flight.routes.kernels import LANES

_ENVIRONMENTS = Path(sys.prefix) / "peers"
_PROGRAMS = Path(__file__).parent / "peers"
ONE, ALL, FREE = "ours, one core", f"ours, {CORES} cores", f"ours in free flight, {CORES} cores"
"""Names of our own figures."""
_OURS = "RK4; turbulence, sensors, law; judged"
_NOTES = {
    ONE: f"held as in the paper; {_OURS}",
    ALL: f"held as in the paper; {_OURS}",
    FREE: f"translation free, as with the peers; {_OURS}",
}


@dataclass(frozen=True, kw_only=True)
class Peer:
    """Another simulator at 1 kHz, with the best settings that its interface offers."""

    environment: str
    """Name of its environment, and of its program."""
    packages: tuple[str, ...]
    """Packages to install."""
    flight_s: float
    """[s] duration of its flights, so that a turn takes about a second."""
    what: str
    """Description of its flights."""
    options: tuple[str, ...] = ()
    """Other arguments of its program."""
    all_cores: bool = False
    """True if it uses every core; it is compared with ours on all cores."""
    lower_order: bool = False
    """True if its integrator is of lower order than ours, which is less work."""


_CRAZYFLOW = ("crazyflow==0.4.0", "jax==0.10.1", "jaxlib==0.10.1", "mujoco==4.0.0", "mujoco-mjx==3.17.0")
_DRONES = "2,000 a core with attitude control, float32, without turbulence and sensors"
PEERS = {
    "crazyflow, RK4": Peer(
        environment="crazyflow",
        packages=_CRAZYFLOW,
        flight_s=1.5,
        options=("rk4",),
        all_cores=True,
        what=f"{CORES} cores; {_DRONES}",
    ),
    "crazyflow, Euler": Peer(
        environment="crazyflow",
        packages=_CRAZYFLOW,
        flight_s=3.0,
        options=("euler",),
        all_cores=True,
        lower_order=True,
        what=f"{CORES} cores; the same with first-order steps, its default",
    ),
    "jsbsim": Peer(
        environment="jsbsim",
        packages=("jsbsim==1.3.3",),
        flight_s=20.0,
        what="one core; turbulence of type 4, without a controller",
    ),
    "mujoco, RK4": Peer(
        environment="mujoco",
        packages=("mujoco==4.0.0",),
        flight_s=20.0,
        all_cores=True,
        what=f"{CORES} cores; rollout of rigid bodies, without turbulence, sensors and controller",
    ),
    "rotorpy, RK45": Peer(
        environment="rotorpy",
        packages=("rotorpy==3.0.0",),
        flight_s=0.5,
        what="one core; Dryden gusts, sensors and its own controller; one flight, as its batches need torch",
    ),
}


def measure(bench: Bench) -> None:
    """Measure every peer that can be installed, in turns with our flights on one core and on all."""
    held = scenario(bench)
    free = replace(held, translation="free")
    flights, rounds = (2, 1) if bench.quick else (16 * LANES, 5)
    parts = [list(range(k * flights + 1, (k + 1) * flights + 1)) for k in range(CORES)]
    with ExitStack() as stack:
        programs = _wait_ready(bench, _start(bench, stack))
        fly = stack.enter_context(fleet(CORES))
        for script in (held, free):
            fly(script, parts)

        def rate(script: Scenario, of: list[list[int]]) -> float:
            begun = time.perf_counter()
            fly(script, of)
            return len(of) * flights * script.duration_s / (time.perf_counter() - begun)

        ours = {ONE: lambda: rate(held, parts[:1]), FREE: lambda: rate(free, parts), ALL: lambda: rate(held, parts)}
        rates = alternate(ours | {name: program.fly for name, program in programs.items()}, rounds, bench)
    for name, values in rates.items():
        note = f"{PEERS[name].packages[0]}: {PEERS[name].what}" if name in PEERS else _NOTES[name]
        bench.row(name, "simulated s/s", values, note)
    compare(bench, rates)


def alternate(actions: Mapping[str, Callable[[], float]], rounds: int, bench: Bench) -> dict[str, list[float]]:
    """Return the results of each action, one of each in every round; leave out a peer that fails."""
    rates: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(rounds):
        for name in list(rates):
            try:
                rates[name].append(actions[name]())
            except PeerError as error:
                del rates[name]
                bench.leave_out(name, str(error))
    return rates


def compare(bench: Bench, rates: Mapping[str, list[float]]) -> None:
    """Record our speed relative to the best peer, turn by turn, on as many cores as it uses."""
    leads = {
        name: _ratios(rates[ALL if PEERS[name].all_cores else ONE], rates[name]) for name in rates if name in PEERS
    }
    equals = [name for name in leads if not PEERS[name].lower_order]
    if equals:
        best = min(equals, key=lambda name: median(leads[name]))
        bench.ratio("lanes_throughput_vs_best_peer", leads[best], ">= 15", f"{best}, on as many cores")
        if PEERS[best].all_cores:
            bench.row(f"free flight vs {best}", "-", _ratios(rates[FREE], rates[best]), "on as many cores")
    for name in [name for name in leads if PEERS[name].lower_order]:
        note = "on as many cores; its steps are of lower order than ours"
        bench.row(f"lanes vs {name}", "-", leads[name], note)
        bench.row(f"free flight vs {name}", "-", _ratios(rates[FREE], rates[name]), note)


def _ratios(ours: list[float], theirs: list[float]) -> list[float]:
    return [mine / its for mine, its in zip(ours, theirs, strict=True)]


def _start(bench: Bench, stack: ExitStack) -> dict[str, Program]:
    """Start the peers' programs, and make missing environments first."""
    programs: dict[str, Program] = {}
    failed: dict[str, PeerError] = {}
    for name, peer in PEERS.items():
        folder = _ENVIRONMENTS / peer.environment
        try:
            if peer.environment in failed:
                raise failed[peer.environment]
            python = environment(folder, peer.packages, new=not bench.quick)
        except PeerError as error:
            failed[peer.environment] = error
            bench.leave_out(name, str(error))
            continue
        seconds = peer.flight_s * (0.1 if bench.quick else 1.0)
        program = str(_PROGRAMS / f"with_{peer.environment}.py")
        command = [str(python), program, str(seconds), *peer.options]
        programs[name] = stack.enter_context(Program(command, folder / f"{name}.log"))
    return programs


def _wait_ready(bench: Bench, programs: dict[str, Program]) -> dict[str, Program]:
    """Return the programs that complete their first flight."""
    print("tools/bench: the peers load and compile", flush=True)
    ready = {}
    for name, program in programs.items():
        try:
            program.ready()
        except PeerError as error:
            bench.leave_out(name, str(error))
        else:
            ready[name] = program
    return ready
