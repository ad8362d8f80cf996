"""H-infinity synthesis for the paper's plant by us and by python-control with slycot."""

import warnings

import control
from table import Bench, in_turns

from firmware_model.config.vehicle import load_vehicle
from gustproof.design.designs import design_problem, load_design
from gustproof.robust.hinf.hinfsyn import hinfsyn

_CALLS = 5  # of each solver in a turn: a single call would run with the caches of the other


def measure(bench: Bench) -> None:
    """Measure both solvers, and check that they agree on the least level."""
    design = load_design("D1")
    problem = design_problem(design, load_vehicle(design.vehicle))
    plant = problem.plant()
    theirs_plant = plant.to_control()

    def theirs() -> float:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return float(control.hinfsyn(theirs_plant, problem.n_meas, problem.n_con)[2])

    def ours() -> float:
        return hinfsyn(plant, problem.n_meas, problem.n_con).gamma_opt

    level, their_level = ours(), theirs()
    if not level <= 1.001 * their_level:
        raise RuntimeError(f"our least level {level:.6g} is above slycot's {their_level:.6g}")
    calls = 1 if bench.quick else _CALLS
    turns = {"ours": lambda: [ours() for _ in range(calls)], "theirs": lambda: [theirs() for _ in range(calls)]}
    times = in_turns(turns, 1 if bench.quick else 9)
    note = f"least level {level:.5f}, slycot's {their_level:.5f}"
    bench.row("hinfsyn, paper's plant", "ms", [1e3 * value / calls for value in times["ours"]], note)
    bench.row("control.hinfsyn with slycot", "ms", [1e3 * value / calls for value in times["theirs"]])
    ratios = [slow / fast for slow, fast in zip(times["theirs"], times["ours"], strict=True)]
    bench.ratio("hinfsyn_vs_control", ratios, ">= 20", "times faster")
