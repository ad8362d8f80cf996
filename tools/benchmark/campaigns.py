"""Cost of a campaign's run besides its flight, and its growth with the number of runs."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from flights import LAW
from table import Bench, in_turns

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from gustproof.studies.campaign.executors import Pool, process_pool
from gustproof.studies.campaign.plan import Campaign, DispersionKind, select_spreads
from gustproof.studies.campaign.runner import fly_campaign
from gustproof.studies.campaign.statistics import compute_statistics

_FEW, _MANY = 1000, 20_000
_TIMES = 5  # small campaigns a turn: a single one ends too soon for a comparison
_FLIGHT_S = 0.02  # five samples: negligible


def measure(bench: Bench) -> None:
    """Measure campaigns of two sizes with one worker: draws, states, metrics, parts, table, statistics; no start-up."""
    few, many = (8, 16) if bench.quick else (_FEW, _MANY)
    with TemporaryDirectory() as folder, process_pool(1) as pool:
        actions: dict[str, Callable[[], object]] = {
            f"campaign, {runs} runs": partial(_fly, runs, times, Path(folder) / f"{runs}.parquet", pool)
            for runs, times in ((few, _TIMES), (many, 1))
        }
        times = in_turns(actions, 1 if bench.quick else 3, lambda: _cpu_s(pool))
    flown = (few * _TIMES, many)
    costs = [[seconds / runs for seconds in taken] for runs, taken in zip(flown, times.values(), strict=True)]
    for name, cost in zip(times, costs, strict=True):
        bench.row(f"{name} of five samples", "us a run", [1e6 * value for value in cost], "CPU of both processes")
    ratios = [much / little for little, much in zip(*costs, strict=True)]
    bench.ratio("cost_per_run_20000_vs_1000", ratios, "<= 1.1", "cost besides the flight")


def _fly(runs: int, times: int, output: Path, pool: Pool) -> None:
    vehicles, scenario = load_vehicle_set("paper"), replace(load_scenario("paper-turbulence"), duration_s=_FLIGHT_S)
    wanted = (DispersionKind.VEHICLE, DispersionKind.GUST, DispersionKind.GYRO)
    spreads = select_spreads(vehicles, scenario, wanted, gust=0.5, attitude_deg=5.0)
    campaign = Campaign(scenario=scenario, laws=(LAW,), vehicles=vehicles, spreads=spreads, cases=runs)
    for _ in range(times):
        fly_campaign(campaign, output, pool)
        compute_statistics(output)
        output.unlink()


def _cpu_s(pool: Pool) -> float:
    """Return the CPU time of this process and the only worker [s]."""
    used: float = pool.submit(time.process_time).result()
    return used + time.process_time()
