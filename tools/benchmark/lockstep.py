"""UDP lockstep beside the bare exchange of the same datagrams, on one core."""

import os
import socket
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from flights import LAW, VEHICLE, scenario
from table import Bench

from firmware_model.mavlink import messages
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.processes import fly

_SAMPLE = messages.imu_template(1).make(0, 4000, 0.1, 0.2, -9.8, 0.1, 0.2, 0.3)
_COMMAND = messages.torque_template(1).make(0, 4000, 0.1, 0.2, 0.3, float("nan"))


def measure(bench: Bench) -> None:
    """Measure flights, each between two bare exchanges."""
    script = scenario(bench)
    exchanges, rounds = (1000, 1) if bench.quick else (20_000, 5)
    bare, factors, ratios = [], [], []
    for turn in range(rounds):
        before = _bare_rate(exchanges)
        with TemporaryDirectory() as folder:
            flight = fly(script, LAW, vehicle=VEHICLE, seed=turn + 1, out=Path(folder))
        if flight.outcome is not FlightOutcome.DONE:
            raise RuntimeError(flight.message)
        bare.append(0.5 * (before + _bare_rate(exchanges)))
        factors.append(flight.realtime_factor)
        ratios.append(flight.realtime_factor / script.dt / bare[-1])
    bench.row("bare exchange of two datagrams, one core", "1/s", bare, "connected, blocking sockets")
    bench.ratio(
        "lockstep_realtime", factors, "300 where the bare exchange does 250000/s", "simulated s/s, with journal"
    )
    bench.ratio("lockstep_vs_pingpong", ratios, ">= .80")


def _bare_rate(exchanges: int) -> float:
    """Return the rate [1/s] at which two processes on one core exchange a sample and a command."""
    allowed = os.sched_getaffinity(0)
    here, there = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with here, there:
        for one in (here, there):
            one.bind(("127.0.0.1", 0))
        here.connect(there.getsockname())
        there.connect(here.getsockname())
        os.sched_setaffinity(0, {min(allowed)})
        child = os.fork()
        if not child:
            for _ in range(exchanges):
                there.recv(2048)
                there.send(_COMMAND)
            os._exit(0)
        begun = time.perf_counter()
        for _ in range(exchanges):
            here.send(_SAMPLE)
            here.recv(2048)
        seconds = time.perf_counter() - begun
        os.waitpid(child, 0)
        os.sched_setaffinity(0, allowed)
    return exchanges / seconds
