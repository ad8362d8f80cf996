"""Flights without messages: many at once, one alone, two processes, and the same arithmetic in C."""

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

from table import Bench, in_turns
from twins import Twin, difference

from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.routes.batch import Case, fly_many
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.kernels import LANES
from gustproof.law.form import Law, load_law

LAW, VEHICLE = load_law("hinf-scheduled"), load_vehicle("paper")
"""The self-scheduled law of order 9, and its vehicle."""
CORES = len(os.sched_getaffinity(0))
"""Number of cores that this process may use."""


def scenario(bench: Bench) -> Scenario:
    """Return a minute of turbulence, or its first second."""
    script = load_scenario("paper-turbulence")
    return replace(script, duration_s=1.0) if bench.quick else script


def measure(bench: Bench) -> None:
    """Measure a batch, one flight, two workers, and both C programs."""
    script = scenario(bench)
    flights, rounds = (2, 1) if bench.quick else (4 * LANES, 5)
    simulated_s = flights * script.duration_s
    seeds = list(range(1, flights + 1))
    actions = {
        "many flights at once, judged": lambda: _fly(script, LAW, seeds),
        "one flight": lambda: fly_direct(script, LAW, vehicle=VEHICLE),
    }
    with TemporaryDirectory() as folder:
        for name, width in (("C, scalar", 1), (f"C, SIMD, {LANES} flights at once", LANES)):
            try:
                twin = Twin(Path(folder), script, LAW, VEHICLE, width)
            except (FileNotFoundError, subprocess.CalledProcessError) as error:
                bench.leave_out(name, str(error))
                continue
            if off := difference(twin, script, LAW, VEHICLE):
                bench.leave_out(name, f"differs from our flight by {off:.1g}")
                continue
            actions[name] = twin.prepare(seeds)
        times = in_turns(actions, rounds)
    for name, seconds in times.items():
        amount = script.duration_s if name == "one flight" else simulated_s
        note = "our bits, without unused sensors, records and metrics" if name[0] == "C" else ""
        bench.row(name, "simulated s/s", [amount / value for value in seconds], note)
    lanes, simd = times["many flights at once, judged"], times.get(f"C, SIMD, {LANES} flights at once")
    if simd:
        ratios = [ours / theirs for ours, theirs in zip(lanes, simd, strict=True)]
        bench.ratio("lanes_time_vs_c_simd", ratios, "<= 1.25")
    if not bench.quick:
        _workers(bench, script, rounds)


def _fly(script: Scenario, law: Law, seeds: list[int]) -> int:
    return len(fly_many(script, law, [Case(vehicle=VEHICLE, seed=seed) for seed in seeds]))


@contextmanager
def fleet(workers: int) -> Iterator[Callable[[Scenario, list[list[int]]], None]]:
    """Yield a function that flies each list of seeds in a process of its own; its first call starts the processes."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:

        def fly(script: Scenario, parts: list[list[int]]) -> None:
            futures: list[Future[int]] = [pool.submit(_fly, script, LAW, part) for part in parts]
            for future in futures:
                future.result()

        yield fly


def _workers(bench: Bench, script: Scenario, rounds: int) -> None:
    """Measure the same flights, a second's work, by one process and by two."""
    seeds = list(range(1, 32 * LANES + 1))
    halves = [seeds[::2], seeds[1::2]]
    with fleet(2) as fly:
        actions = {"one": lambda: fly(script, [seeds]), "two": lambda: fly(script, halves)}
        times = in_turns(actions, rounds, time.perf_counter)
    ratios = [one / two for one, two in zip(times["one"], times["two"], strict=True)]
    bench.ratio("two_workers_vs_one", ratios, ">= 1.8", "on two idle cores")
