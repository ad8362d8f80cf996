"""Law that commands rates, over the rate loops of one autopilot: each axis no faster than its own loop."""

from dataclasses import replace

import numpy as np

from firmware_model.config.vehicle import Vehicle
from gustproof.design.derive import DesignReport, derive
from gustproof.design.designs import Design, Weight
from gustproof.design.inner_loops import InnerLoops
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.robust.lti.state_space import Matrix

_TOLERANCE = 1.05  # [-] on the crossover
_ITERATIONS = 30


def derive_over(design: Design, loops: InnerLoops, vehicle: Vehicle | None = None) -> tuple[Law, DesignReport]:
    """Return the law of a design for rates over the autopilot's `loops`, and its report.

    Beyond its bandwidth a rate loop is not the one that was identified: saturation, slew and structure differ. So the
    weight of the command is raised, axis by axis, until no crossover is beyond it. Level and names of design and law
    are the loops' own.

    Raises
    ------
    DesignError
        If the design is none for rates, or the crossovers can't be reached.
    """
    if design.rate_loop_lag is None:
        raise DesignError(
            f"design {design.name} commands torque: rate loops are for a design with rate_loop_lag, as R1"
        )
    fastest = loops.fastest()
    least = np.asarray(design.W_u.high)
    weight: Matrix = least
    name, law_name = (f"{each}-{loops.name}" for each in (design.name, design.law or design.name))
    design = replace(design, name=name, law=law_name, inner=loops, gamma=None)
    for _ in range(_ITERATIONS):
        roll, pitch, yaw = weight.tolist()
        constant = Weight(low=(roll, pitch, yaw), high=(roll, pitch, yaw), corner=1.0)
        law, report = derive(replace(design, W_u=constant), vehicle)
        excess = np.array([loop.crossover for loop in report.sampled.input[:3]]) / fastest
        if np.all((excess < _TOLERANCE) & ((excess > 1.0 / _TOLERANCE**2) | (weight <= least))):
            return law, report
        weight = np.maximum(weight * np.clip(excess, 0.5, 2.0), least)
    raise DesignError(f"design {design.name}: no weight of the command has the crossovers {np.round(fastest, 1)} rad/s")
