"""Certified gain of an attitude loop over an envelope of attitudes and rates that change at any speed."""

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from gustproof.certify.certificate import Certificate
from gustproof.certify.check.dissipation import gain_inequality, rate_bounded_inequalities
from gustproof.certify.check.evidence import DerivedLoop, check_evidence, is_name
from gustproof.certify.check.system import Refusal
from gustproof.certify.gain.multipliers import Multipliers, best_multipliers
from gustproof.certify.gain.rate_bounded_multipliers import RateBoundedMultipliers, rate_bounded_multipliers
from gustproof.certify.gain.worst_schedule import worst_schedule, worst_triangle_schedule
from gustproof.lti.rational import multiply, to_rational, transpose
from gustproof.lti.state_space import LinearSystem, Matrix, as_continuous, as_lti
from gustproof.model.interconnection import Interconnection
from gustproof.model.lft import Uncertain, close_loop, connect, star, system_from_matrix
from gustproof.model.rotational import Envelope, rotation, uncertain_airframe

_MARGINS = (1e-6, 1e-5, 1e-4, 1e-3)
"""[-] relative margins above the solver's level, tried in turn: rounding of the multipliers needs some."""


def certify_gain(
    problem: Interconnection,
    controller: LinearSystem,
    *,
    angle: float,
    rate: float,
    scheduled: bool = False,
    rate_bounded: bool = False,
    level: float | None = None,
) -> Certificate:
    """Return a certificate of the L2 gain from w to z of a design problem closed by a continuous controller.

    The gain holds for |phi|, |theta| <= `angle` and |p|, |q|, |r| <= `rate` that change arbitrarily fast. The exact
    rotational dynamics of the diagram's airframe are an LFT of order 7, with Delta any function of time. With
    `rate_bounded`, phi and theta change no faster than the kinematics allow at such rates, and P depends on them. The
    proof still assumes nothing of the derivatives of p, q and r.

    Parameters
    ----------
    problem
        From `torque_problem`: its block "airframe" gives inertia, leak and damping.
    controller
        Continuous, `u = K y`; if `scheduled`, its first six states are its estimates of attitude and rates.
    angle
        [rad] of the envelope, below pi/2.
    rate
        [rad/s] of the envelope.
    scheduled
        True if the controller contains the same `A(rho)` as the airframe, with exact rho.
    rate_bounded
        True to use bounds on the speed of phi and theta; about ten times as slow.
    level
        [-] gain to certify; by default the least that can be proved.

    Raises
    ------
    ValueError
        If the envelope is invalid, the design commands rates, has a reference or an accelerometer, the controller is
        discrete, or the loop is unstable at hover.

    Examples
    --------
    >>> from gustproof import certify_gain, derive, design_problem, load_design, load_vehicle
    >>> design = load_design("D1")
    >>> problem = design_problem(design, load_vehicle("paper"))
    >>> controller = derive(design)[1].result.controller
    >>> certificate = certify_gain(problem, controller, angle=0.01, rate=0.05)
    >>> f"proven {certificate.proven}, gain {certificate.gain:.2f}"
    'proven True, gain 0.41'
    """
    loop = attitude_loop(problem, controller, Envelope(angle=angle, rate=rate), scheduled=scheduled)
    leak, damping, _ = _airframe(problem)
    turning = attitude_speeds(angle, rate, leak=leak) if rate_bounded else None
    rho = (
        "any function of time within the envelope"
        if turning is None
        else (
            f"within the envelope, |phi'| <= {turning[0]:.6f} and |theta'| <= {turning[1]:.6f} rad/s, "
            "which the kinematics imply; p, q, r at any speed"
        )
    )
    return certify_lft(
        loop,
        assumes={
            "plant": "continuous, rotation exact, actuators without limits",
            "leak_per_s": leak,
            "rate_damping_per_s": damping,
            "delay_samples": 0,
            "angle_rad": angle,
            "rate_rad_s": rate,
            "rho": f"{rho}; exact in the controller" if scheduled else rho,
            "horizon_s": None,
            "noise": "part of w, square integrable",
        },
        level=level,
        speeds=envelope_speeds(angle, rate, leak=leak) if rate_bounded else None,
        signals="from disturbance and noise to error and command, all weighted,",
        scope=f"for all |phi|, |theta| <= {angle:g} rad and |p|, |q|, |r| <= {rate:g} rad/s",
    )


def attitude_speeds(angle: float, rate: float, *, leak: float) -> tuple[float, float]:
    """Return bounds of |phi'| and |theta'| [rad/s] inside an envelope, from the kinematics and their leak [1/s].

    phi' = p + tan(theta) (sin(phi) q + cos(phi) r) - leak phi, theta' = cos(phi) q - sin(phi) r - leak theta.
    """
    across = rate * (1.0 + math.sin(angle))
    bounds = rate + math.tan(angle) * across + leak * angle, across + leak * angle
    of_phi, of_theta = (math.ceil(1e6 * bound + 1e-3) / 1e6 for bound in bounds)  # up: the printed value is used
    return of_phi, of_theta


def certify_lft(
    loop: Uncertain,
    *,
    assumes: dict[str, Any],
    level: float | None = None,
    speeds: Mapping[str, float] | None = None,
    signals: str = "from w to z",
    scope: str = "for every Delta(t) of the envelope",
) -> Certificate:
    """Return a certificate of the L2 gain of any continuous loop with real parameters.

    Normalised parameters named in `speeds` [1/s] keep these bounds on their derivatives; the others may change at any
    speed. The lower bound is the gain that a schedule of the parameters reaches in simulation. `signals` and `scope`
    are the statement's words for the loop's signals and its parameters.

    Raises
    ------
    ValueError
        If the level is not positive, or a block's name no word. If the loop is discrete, unstable at hover, lacks a
        block named in `speeds`, or has a block that is no real parameter.
    """
    if level is not None and not 0.0 < level < math.inf:
        raise ValueError(f"level is {level}, must be positive")
    bounds = _speed_bounds(loop, speeds)
    multipliers = best_multipliers(loop) if speeds is None else rate_bounded_multipliers(loop, bounds)
    wanted, proven = level, False
    evidence: dict[str, Any] = {}
    if multipliers is not None:
        evidence = _evidence(loop, multipliers, bounds)
        candidates = [multipliers.level * (1.0 + margin) for margin in _MARGINS] if level is None else [level]
        wanted, proven = _first_proven(candidates, evidence)
    claim = "is not bounded by these multipliers" if wanted is None else f"is below {wanted:.6g}"
    return Certificate(
        statement=f"the L2 gain {signals} {claim} {scope}",
        gain=wanted,
        lower_bound=lower_bound(loop, speeds),
        proven=proven,
        assumes=assumes,
        evidence=evidence,
        residual=None if wanted is None or not evidence else _residual(wanted, evidence),
    )


def derived_loop(loop: Uncertain, speeds: Mapping[str, float] | None) -> DerivedLoop:
    """Return a loop in the form that the check takes, with parameters as fast as `speeds` [1/s]."""
    return DerivedLoop(
        system=_matrices(loop),
        blocks=[(block.name, block.shape[0]) for block in loop.blocks],
        speeds=_speed_bounds(loop, speeds),
    )


def lower_bound(loop: Uncertain, speeds: Mapping[str, float] | None) -> float:
    """Return a gain that a schedule of the parameters reaches in simulation, with parameters as fast as `speeds`."""
    if speeds is None:
        return worst_schedule(loop).gain
    return worst_triangle_schedule(loop, _speed_bounds(loop, speeds)).gain


def _matrices(loop: Uncertain) -> dict[str, list[list[float]]]:
    return {name: getattr(loop.M, name).tolist() for name in "ABCD"}


def envelope_speeds(angle: float, rate: float, *, leak: float) -> dict[str, float]:
    """Return bounds [1/s] of the speeds of the normalised t and v inside an envelope."""
    edge = math.tan(angle / 2.0)  # t = tan(phi / 2) over its largest value, and v likewise
    turning = attitude_speeds(angle, rate, leak=leak)
    t, v = ((1.0 + 1e-9) * turn * (1.0 + edge**2) / (2.0 * edge) for turn in turning)
    return {"t": t, "v": v}


def _speed_bounds(loop: Uncertain, speeds: Mapping[str, float] | None) -> list[float | None]:
    """Return the bound on the speed of each block; `None` without one."""
    names, bounds = [block.name for block in loop.blocks], speeds or {}
    if odd := [name for name in names if not is_name(name)]:
        raise ValueError(f"block '{odd[0]}': a certificate names blocks by letters, digits, '_', '-' and '.' alone")
    if unknown := sorted(set(bounds) - set(names)):
        raise ValueError(f"speeds name '{unknown[0]}', there are {', '.join(names)}")
    return [bounds.get(name) for name in names]


def _first_proven(candidates: Sequence[float], evidence: dict[str, Any]) -> tuple[float, bool]:
    """Return the first proven candidate and True, or the last one and False; it becomes the evidence's level."""
    for candidate in candidates:
        evidence["level"] = candidate
        if _is_proven(evidence):
            return candidate, True
    return candidates[-1], False


def attitude_loop(
    problem: Interconnection, controller: LinearSystem, envelope: Envelope, *, scheduled: bool
) -> Uncertain:
    """Return the loop of a design problem and a controller, from w to z, with exact rotation over the envelope."""
    leak, damping, inertia_B = _airframe(problem)
    dynamics = rotation(inertia_B, envelope)
    P = connect(problem, {"airframe": uncertain_airframe(dynamics, leak=leak, rate_damping=damping)})
    K = as_continuous("the controller", controller)
    if not scheduled:
        return close_loop(P, K)
    n = K.order
    excess = (dynamics + -dynamics.nominal_system().D) @ np.eye(9, 6)  # what A(rho) adds to hover's
    system = np.block([[K.A, K.B], [K.C, K.D]]) + np.eye(n + K.n_outputs, 6) @ excess @ np.eye(6, n + K.n_inputs)
    return star(P, system_from_matrix(system, n), K.n_inputs, K.n_outputs)


def _airframe(problem: Interconnection) -> tuple[float, list[float], list[float]]:
    """Return leak [1/s], damping [1/s] and inertia [kg*m^2] by axis, of the diagram's airframe of states (E, omega)."""
    bodies = [as_lti(block.system) for block in problem.blocks if block.name == "airframe"]
    if not bodies:
        raise ValueError("certify supports torque designs only; this one has no airframe, as those that command rates")
    if "reference" in problem.y:
        raise ValueError("certify supports designs that hold level only: this one has a reference, W_r")
    A: Matrix = bodies[0].A
    if not A[0, 0] == A[1, 1] == A[2, 2]:
        raise ValueError("certify supports gyro-only designs: the leak differs between axes, as with an accelerometer")
    damping = [float(-A[k, k]) for k in range(3, 6)]
    return float(-A[0, 0]), damping, [float(1.0 / bodies[0].B[3 + k, k]) for k in range(3)]


def _evidence(
    loop: Uncertain, multipliers: Multipliers | RateBoundedMultipliers, speeds: Sequence[float | None]
) -> dict[str, Any]:
    common = {"system": _matrices(loop), "coordinates": multipliers.coordinates.tolist()}
    blocks: list[dict[str, Any]] = [{"name": block.name, "size": block.shape[0]} for block in loop.blocks]
    if isinstance(multipliers, Multipliers):
        pairs = zip(multipliers.D, multipliers.G, strict=True)
        blocks = [block | scalings for block, scalings in zip(blocks, _scalings(pairs), strict=True)]
        return {"kind": "gain", **common, "P": multipliers.P.tolist(), "blocks": blocks}
    return {
        "kind": "slow gain",
        **common,
        "P": [term.tolist() for term in multipliers.P],
        "Y": multipliers.Y.tolist(),
        "blocks": [block | {"speed": speed} for block, speed in zip(blocks, speeds, strict=True)],
        "vertices": [_scalings(pairs) for pairs in multipliers.scalings],
    }


def _scalings(pairs: Iterable[tuple[Matrix, Matrix]]) -> list[dict[str, Any]]:
    return [{"D": D.tolist(), "G": G.tolist()} for D, G in pairs]


def _is_proven(evidence: dict[str, Any]) -> bool:
    try:
        return check_evidence(evidence).accepted
    except Refusal:
        return False


def _residual(level: float, evidence: dict[str, Any]) -> float:
    """Return the least eigenvalue of the inequalities, in the coordinates of their Lyapunov matrix."""
    exact_level = Fraction(level)
    forms = (
        [gain_inequality(exact_level, evidence)]
        if evidence["kind"] == "gain"
        else rate_bounded_inequalities(exact_level, evidence)
    )
    inverse = np.linalg.inv(evidence["coordinates"])
    least = []
    for form in forms:
        change = np.eye(len(form.middle))
        change[: len(inverse), : len(inverse)] = inverse
        moved = to_rational(change.tolist())
        matrix = np.array(multiply(transpose(moved), multiply(form.middle, moved)), dtype=np.float64)
        least.append(float(np.linalg.eigvalsh(matrix)[0]))
    return min(least)
