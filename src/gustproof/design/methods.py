"""One small adapter for each synthesis method that turns a design into a controller."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from firmware_model.types import AXES
from gustproof.airframe.rotational import Envelope
from gustproof.design.designs import Design
from gustproof.errors import DesignError
from gustproof.prove.attitude_gain import attitude_plant, certify_gain
from gustproof.robust.coprime.ncfsyn import ncfsyn
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.gain.lft_gain import certify_lft
from gustproof.robust.hinf.checked_controller import CheckedController
from gustproof.robust.hinf.h2syn import h2syn
from gustproof.robust.lpv.lpvsyn import LftController, lpvsyn
from gustproof.robust.lti.state_space import Lti, gain, series
from gustproof.robust.mu.musyn import musyn
from gustproof.robust.uncertain.interconnection import Interconnection
from gustproof.robust.uncertain.uncertain_system import Uncertain, lft

_CORNER = 1.0 / 6.0
"""[-] part of the crossover below which the shaped loop weights attitude, the integral of the rate."""


def solve_h2(design: Design, problem: Interconnection) -> CheckedController:
    """Return the controller of the least H2 norm: the least rms of z for white noise w."""
    return h2syn(problem.plant(), problem.n_meas, problem.n_con)


def solve_loop_shaping(design: Design, problem: Interconnection, *, crossover: float) -> CheckedController:
    """Return the loop-shaping controller of Glover and McFarlane for a design of gyros alone, each axis by itself.

    W1 scales each axis so that the loop from torque to gyro crosses 1 at `crossover` [rad/s]. Below a sixth of it W1
    rises by 1 / s down to the leak, so that the attitude is held. The weights of the design have no part in it. Level
    and norm are those of the worst axis.

    Raises
    ------
    DesignError
        If the design measures more than gyros or commands rates, or a shaped plant has no coprime factors.
    """
    if problem.n_meas != problem.n_con or design.rate_loop_lag is not None:
        raise DesignError(f"design {design.name}: ncfsyn shapes the loop from torque to gyro, and that alone")
    plant = problem.system(("u",), problem.y)
    # (s + corner) / (s + leak)
    one = np.eye(1)
    rise = Lti(A=-design.leak * one, B=one, C=(_CORNER * crossover - design.leak) * one, D=one)
    found = []
    for axis in range(problem.n_con):
        G = plant.subsystem([axis], [axis]).drop_unconnected()
        reached = float(abs(series(rise, G).response(np.array([crossover]))[0, 0, 0]))
        found.append(ncfsyn(G, series(rise, gain(one / reached)), backoff=design.backoff))
    worst = max(found, key=lambda shaped: shaped.norm)
    parts = [[getattr(shaped.lti, name) for shaped in found] for name in "ABCD"]
    A, B, C, D = (scipy.linalg.block_diag(*matrices) for matrices in parts)
    turn = np.arange(len(A)).reshape(len(found), -1).T.ravel()  # a law takes the axes in turn
    return CheckedController(
        lti=Lti(A=A[np.ix_(turn, turn)], B=B[turn], C=C[:, turn], D=D),
        gamma=max(shaped.gamma for shaped in found),
        norm=worst.norm,
        omega=worst.omega,
        checks=tuple(f"{axis}: {check}" for axis, shaped in zip(AXES, found, strict=True) for check in shaped.checks),
    )


def solve_mu(
    design: Design, problem: Interconnection, *, envelope: Envelope, progress: Callable[[float, str], None]
) -> CheckedController:
    """Return the controller of D-K iteration with a small L2 gain over an envelope of attitudes and rates.

    Parameters may change at any speed, so that `certify_gain` proves its bound: what it says is one of the checks.

    Raises
    ------
    DesignError
        If the design commands rates, has a reference or an accelerometer, or no start has a finite bound.
    """
    plant = uncertain_plant(design, problem, envelope)
    result = musyn(plant, problem.n_meas, problem.n_con, measure="l2gain", progress=progress)
    certificate = certify_gain(problem, result.lti, angle=envelope.angle, rate=envelope.rate)
    return replace(result, checks=(*result.checks, _describe_proof(certificate)))


def solve_lpv(
    design: Design, problem: Interconnection, *, envelope: Envelope, progress: Callable[[float, str], None]
) -> LftController:
    """Return the controller of least L2 gain over an envelope that is scheduled on attitude and rates.

    Its states estimate attitude and rates, as those of a central controller. `certify_lft` proves the gain of the loop
    in exact arithmetic, for exact parameters in the controller: what it says is one of the checks.

    Raises
    ------
    DesignError
        If the design commands rates, has a reference or an accelerometer, or the inequalities have no solution.
    """
    plant = uncertain_plant(design, problem, envelope)
    progress(0.0, "matrix inequalities")
    result = lpvsyn(plant, problem.n_meas, problem.n_con, backoff=design.backoff)
    assert isinstance(result, LftController)  # the plant is an LFT
    progress(0.2, f"level {result.gamma:.4g}, proving the gain")
    certificate = certify_lft(lft(plant, result.scheduled, problem.n_meas, problem.n_con), assumes={})
    return replace(result, checks=(*result.checks, _describe_proof(certificate)))


def _describe_proof(certificate: Certificate) -> str:
    return f"{'proven exactly' if certificate.proven else 'NOT proven exactly'}: {certificate.statement}"


def uncertain_plant(design: Design, problem: Interconnection, envelope: Envelope) -> Uncertain:
    """Return the plant of a design over an envelope.

    Raises
    ------
    DesignError
        If the design commands rates, has a reference or an accelerometer.
    """
    try:
        return attitude_plant(problem, envelope)
    except ValueError as error:
        raise DesignError(f"design {design.name}: {error}") from None


def named_for(method: str, design: Design, *, estimates: bool) -> Design:
    """Return a design whose law is named for its method, and linear unless its states estimate attitude and rates."""
    return replace(design, law=f"{design.name}-{method}", scheduled=design.scheduled and estimates)
