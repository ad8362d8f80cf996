"""One small adapter for each synthesis method that turns a design into a controller."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gustproof.certify.gain.l2_gain import attitude_plant
from gustproof.errors import DesignError
from gustproof.lti.state_space import Lti, gain, series
from gustproof.model.interconnection import Interconnection
from gustproof.model.rotational import Envelope
from gustproof.synthesis.checked_controller import CheckedController
from gustproof.synthesis.coprime.ncfsyn import ncfsyn
from gustproof.synthesis.designs import Design
from gustproof.synthesis.hinf.h2syn import h2syn
from gustproof.synthesis.mu.musyn import musyn

_CORNER = 1.0 / 6.0
"""[-] part of the crossover below which the shaped loop weights attitude, the integral of the rate."""


def solve_h2(design: Design, problem: Interconnection) -> CheckedController:
    """Return the controller of the least H2 norm: the least rms of z for white noise w."""
    return h2syn(problem.plant(), problem.n_meas, problem.n_con)


def solve_loop_shaping(design: Design, problem: Interconnection, *, crossover: float) -> CheckedController:
    """Return the loop-shaping controller of Glover and McFarlane for a design of gyros alone.

    W1 scales each axis so that the loop from torque to gyro crosses 1 at `crossover` [rad/s]. Below a sixth of it W1
    rises by 1 / s down to the leak, so that the attitude is held. The weights of the design have no part in it.

    Raises
    ------
    DesignError
        If the design measures more than gyros or commands rates, or the shaped plant has no coprime factors.
    """
    if problem.n_meas != problem.n_con or design.rate_loop_lag is not None:
        raise DesignError(f"design {design.name}: ncfsyn shapes the loop from torque to gyro, and that alone")
    n, corner = problem.n_con, _CORNER * crossover
    # (s + corner) / (s + leak) on each axis
    rise = Lti(A=-design.leak * np.eye(n), B=np.eye(n), C=(corner - design.leak) * np.eye(n), D=np.eye(n))
    plant = problem.system(("u",), problem.y)
    reached = np.abs(np.diagonal(series(rise, plant).response(np.array([crossover]))[0]))
    return ncfsyn(plant, series(rise, gain(np.diag(1.0 / reached))), backoff=design.backoff)


def solve_mu(
    design: Design, problem: Interconnection, *, envelope: Envelope, progress: Callable[[float, str], None]
) -> CheckedController:
    """Return the controller of D-K iteration with a small L2 gain over an envelope of attitudes and rates.

    Parameters may change at any speed, so that `certify_gain` proves its bound.
    """
    plant = attitude_plant(problem, envelope)
    return musyn(plant, problem.n_meas, problem.n_con, measure="l2gain", progress=progress)


def unscheduled(design: Design) -> Design:
    """Return a design whose law is linear: only the states of some controllers estimate attitude and rates."""
    return replace(design, scheduled=False)
