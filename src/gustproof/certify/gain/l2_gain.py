"""Certified gain of an attitude loop over an envelope of attitudes and rates that change at any speed."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from gustproof.certify.certificate import Certificate
from gustproof.certify.check.dissipation import gain_inequality, rate_bounded_inequalities
from gustproof.certify.check.evidence import DerivedLoop, check_evidence, is_name
from gustproof.certify.check.system import Refusal
from gustproof.certify.gain.constrained_multipliers import ConstrainedMultipliers, constrained_multipliers
from gustproof.certify.gain.exact_loop import loop_radius
from gustproof.certify.gain.linear_members import worst_member
from gustproof.certify.gain.multipliers import Multipliers, best_multipliers
from gustproof.certify.gain.parts import Delay, Part, Sector, Slope
from gustproof.certify.gain.rate_bounded_multipliers import RateBoundedMultipliers, rate_bounded_multipliers
from gustproof.certify.gain.worst_schedule import worst_schedule, worst_triangle_schedule
from gustproof.law.form import Law
from gustproof.law.schedule import continuous_controller, sampled_controller
from gustproof.lti.rational import RationalMatrix, multiply, to_rational, transpose
from gustproof.lti.state_space import LinearSystem, Lti, Matrix, as_continuous, as_lti, gain, lft
from gustproof.model.interconnection import Interconnection
from gustproof.model.lft import (
    Uncertain,
    append,
    as_uncertain,
    close_loop,
    connect,
    star,
    system_from_matrix,
    ultidyn,
)
from gustproof.model.rotational import Envelope, rotation, uncertain_airframe
from gustproof.model.uncertainty import RealBlock, rows

_SAME_RANGE = 1e-9
"""[-] relative difference of ranges that counts as rounding."""
_DECAY = 1e-9
"""[rad/s] least decay of a loop that counts as stable, above rounding."""
_SATURATION_POLES = (3.0,)
"""[rad/s] poles of the multipliers of a limit."""
_MARGINS = (1e-6, 1e-5, 1e-4, 1e-3)
"""[-] relative margins above the solver's level, tried in turn: rounding of the multipliers needs some."""


def certify_gain(
    problem: Interconnection,
    controller: LinearSystem | Uncertain | Law,
    *,
    angle: float,
    rate: float,
    scheduled: bool = False,
    rate_bounded: bool = False,
    level: float | None = None,
    delay: Delay | None = None,
    saturation: float | None = None,
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
        Continuous, `u = K y`; if `scheduled`, its first six states are its estimates of attitude and rates. Or an LFT
        in the parameters of `rotation`, as `lpvsyn` returns it: it knows them exactly, within its own ranges. Or a law
        with such a schedule: what it was sampled from, and the gain holds for whatever rounding did to the loop.
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
    delay
        Delay of the command; `None` without one.
    saturation
        [-] largest command over the limit of the torque, above 1, or infinite; `None` without a limit.

    Raises
    ------
    ValueError
        If the envelope is invalid, the design commands rates, has a reference or an accelerometer, or the loop is
        unstable at hover. If the controller is discrete, or scheduled on smaller ranges. With infinite `saturation`
        also if plant or controller is not stable alone: the loop then has no gain, and `certify_boundedness` states
        what holds within a bounded moment.

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
    parts = command_parts(delay, saturation)
    envelope = Envelope(angle=angle, rate=rate)
    loop = attitude_loop(problem, controller, envelope, scheduled=scheduled, delay=delay, saturation=saturation)
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
            "plant": "continuous, rotation exact, " + _describe_command(saturation),
            "leak_per_s": leak,
            "rate_damping_per_s": damping,
            **_describe_delay(delay),
            "angle_rad": angle,
            "rate_rad_s": rate,
            "rho": f"{rho}; exact in the controller" if scheduled or isinstance(controller, Uncertain | Law) else rho,
            "horizon_s": None,
            "noise": "part of w, square integrable",
        },
        level=level,
        speeds=envelope_speeds(angle, rate, leak=leak) if rate_bounded else None,
        parts=parts,
        radius=law_rounding(problem, controller, envelope, loop, delay=delay, saturation=saturation),
        signals="from disturbance and noise to error and command, all weighted,",
        scope=f"for all |phi|, |theta| <= {angle:g} rad and |p|, |q|, |r| <= {rate:g} rad/s",
    )


def command_parts(delay: Delay | None, saturation: float | None) -> dict[str, Part]:
    """Return the parts of the command's path by name, in the order in which the command meets them.

    What a limit takes off a command within `saturation` times the limit is a share of it, at most 1 - 1 / `saturation`.
    Of any command it has slopes in [0, 1].

    Raises
    ------
    ValueError
        If `saturation` is not above 1.
    """
    parts: dict[str, Part] = {} if delay is None else {"delay": delay}
    if saturation is None:
        return parts
    if not saturation > 1.0:
        raise ValueError(f"saturation is {saturation}, must be above 1: smaller commands meet no limit")
    return parts | {"saturation": Slope(poles=_SATURATION_POLES) if math.isinf(saturation) else Sector()}


def _describe_command(saturation: float | None) -> str:
    if saturation is None:
        return "actuators without limits"
    size = "of any size" if math.isinf(saturation) else f"of at most {saturation:g} times the limit"
    return f"torque limited, commands {size}"


def _describe_delay(delay: Delay | None) -> dict[str, Any]:
    if delay is None:
        return {"delay_samples": 0}
    return {"delay_s": f"{'varies at will' if delay.varying else 'constant'}, in [0, {delay.largest:g}]"}


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
    parts: Mapping[str, Part] | None = None,
    radius: dict[str, RationalMatrix] | None = None,
    signals: str = "from w to z",
    scope: str = "for every Delta(t) of the envelope",
) -> Certificate:
    """Return a certificate of the L2 gain of any continuous loop with real parameters, delays, sectors and slopes.

    Normalised parameters named in `speeds` [1/s] keep these bounds on their derivatives; the others may change at any
    speed. Full blocks, as from `ultidyn`, are what `parts` says. The lower bound is the gain that a schedule of the
    parameters reaches in simulation, or a linear member of the parts at some frequency. With a `radius` the gain is
    proved of all loops within these distances too. `signals` and `scope` are the statement's words for the loop's
    signals and its parameters.

    Raises
    ------
    ValueError
        If the level is not positive, or a block's name no word. If the loop is discrete, unstable at Delta = 0, or
        closed without inputs or outputs. If `speeds` or `parts` name no block, or a block is neither a real parameter
        nor a part. If the loop is not stable with a sector or slope of 1: a saturated loop with a pole on the axis has
        no gain.

    References
    ----------
    See `gustproof.certify.check.quadratic_constraints`.

    Examples
    --------
    >>> from gustproof import Delay, Lti, Uncertain, certify_lft, ultidyn
    >>> M = Lti(A=[[-3.0]], B=[[-2.0, 1.0]], C=[[1.0], [1.0]], D=[[0.0, 0.0], [0.0, 0.0]])
    >>> loop = Uncertain(M=M, blocks=ultidyn("late").blocks)  # x' = -x - 2 x(t - theta) + w, z = x
    >>> certificate = certify_lft(loop, assumes={"plant": "a lag"}, parts={"late": Delay(largest=0.5)})
    >>> f"{certificate.lower_bound:.2f} to {certificate.gain:.2f}, proven {certificate.proven}"
    '0.66 to 0.68, proven True'
    """
    if level is not None and not 0.0 < level < math.inf:
        raise ValueError(f"level is {level}, must be positive")
    _require_channels(loop)
    bounds = _speed_bounds(loop, speeds)
    _check_parts(loop, speeds, parts or {})
    multipliers = _find_multipliers(loop, speeds, parts)
    wanted, proven = level, False
    evidence: dict[str, Any] = {}
    if multipliers is not None:
        evidence = _evidence(loop, multipliers, bounds)
        candidates = [multipliers.level * (1.0 + margin) for margin in _MARGINS] if level is None else [level]
        derived = None if radius is None else derived_loop(loop, speeds, parts, radius)
        wanted, proven = _first_proven(candidates, evidence, derived)
    claim = "is not bounded by these multipliers" if wanted is None else f"is below {wanted:.6g}"
    return Certificate(
        statement=f"the L2 gain {signals} {claim} {scope}",
        gain=wanted,
        lower_bound=lower_bound(loop, speeds, parts),
        proven=proven,
        assumes=assumes,
        evidence=evidence,
        residual=None if wanted is None or not evidence else _residual(wanted, evidence),
    )


def _find_multipliers(
    loop: Uncertain, speeds: Mapping[str, float] | None, parts: Mapping[str, Part] | None
) -> Multipliers | RateBoundedMultipliers | ConstrainedMultipliers | None:
    if parts:
        return constrained_multipliers(loop, parts)
    return best_multipliers(loop) if speeds is None else rate_bounded_multipliers(loop, _speed_bounds(loop, speeds))


def derived_loop(
    loop: Uncertain,
    speeds: Mapping[str, float] | None,
    parts: Mapping[str, Part] | None = None,
    radius: dict[str, RationalMatrix] | None = None,
) -> DerivedLoop:
    """Return a loop in the form that the check takes, with parameters as fast as `speeds` [1/s]."""
    named = parts or {}
    return DerivedLoop(
        system=_matrices(loop),
        blocks=[(block.name, block.shape[0]) for block in loop.blocks],
        speeds=_speed_bounds(loop, speeds),
        parts=[named[block.name].entries() if block.name in named else {} for block in loop.blocks],
        radius=radius,
    )


def lower_bound(loop: Uncertain, speeds: Mapping[str, float] | None, parts: Mapping[str, Part] | None = None) -> float:
    """Return a gain that is reached: by a schedule of the parameters in simulation, or by a linear member of the parts.

    Parameters are as fast as `speeds`.
    """
    if parts:
        member = _largest_member(loop, parts)
        scheduled = worst_schedule(member).gain if member.blocks and member.M.is_stable() else 0.0
        return max(worst_member(loop, parts), scheduled)
    if speeds is None:
        return worst_schedule(loop).gain
    return worst_triangle_schedule(loop, _speed_bounds(loop, speeds)).gain


def _largest_member(loop: Uncertain, parts: Mapping[str, Part]) -> Uncertain:
    """Return the loop without delay, and with p = q in its sectors and slopes."""
    owner = [block.name for block in loop.blocks for _ in range(block.shape[0])]
    own = [k for k, name in enumerate(owner) if name in parts]
    other = [k for k, name in enumerate(owner) if name not in parts]
    outputs, inputs = ([*other, *range(len(owner), count), *own] for count in (loop.M.n_outputs, loop.M.n_inputs))
    slopes = np.diag([0.0 if isinstance(parts[owner[k]], Delay) else 1.0 for k in own])
    blocks = tuple(block for block in loop.blocks if block.name not in parts)
    return Uncertain(M=lft(loop.M.subsystem(outputs, inputs), gain(slopes)), blocks=blocks)


def _require_channels(loop: Uncertain) -> None:
    if not (loop.n_inputs and loop.n_outputs):
        raise ValueError("the loop has no inputs or no outputs left, so no gain")


def _check_parts(loop: Uncertain, speeds: Mapping[str, float] | None, parts: Mapping[str, Part]) -> None:
    """Raise `ValueError` unless the loop's full blocks are the `parts`, and it has a gain with each of them at 1."""
    if parts and speeds is not None:
        raise ValueError("bounds on speeds and parts other than real parameters are not proved together")
    full = {block.name: block for block in loop.blocks if not isinstance(block, RealBlock)}
    if unknown := sorted(set(parts) - set(full)):
        raise ValueError(f"parts name '{unknown[0]}', there are full blocks {', '.join(full) or 'none'}")
    if other := sorted(set(full) - set(parts)):
        raise ValueError(f"block '{other[0]}' is no real parameter")
    for name, part in parts.items():
        shape = full[name].shape
        if shape[0] != shape[1]:
            raise ValueError(f"block '{name}' is {shape[0]} x {shape[1]}, a part must be square")
        if isinstance(part, Delay):
            continue
        worst = complex(max(loop.substitute({name: np.eye(shape[0])}).poles(), key=lambda pole: pole.real))
        if worst.real > -_DECAY:
            raise ValueError(
                f"with slope 1 of '{name}' the loop has a pole at {worst:.3g} rad/s: no global L2 gain exists; "
                "a saturated loop needs a plant and a controller that are stable alone"
            )


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


def _first_proven(
    candidates: Sequence[float], evidence: dict[str, Any], derived: DerivedLoop | None
) -> tuple[float, bool]:
    """Return the first candidate proven of the evidence's loop, and of one derived, and True; or the last and False.

    It becomes the evidence's level.
    """
    for candidate in candidates:
        evidence["level"] = candidate
        if _is_proven(evidence) and (derived is None or _is_proven(evidence, derived)):
            return candidate, True
    return candidates[-1], False


def attitude_loop(
    problem: Interconnection,
    controller: LinearSystem | Uncertain | Law,
    envelope: Envelope,
    *,
    scheduled: bool,
    delay: Delay | None = None,
    saturation: float | None = None,
) -> Uncertain:
    """Return the loop of a design problem and a controller, from w to z, with exact rotation over the envelope.

    The command passes the `command_parts`: what a delay changes is added to it, what a limit cuts off is taken away.
    """
    P = _driven_plant(problem, envelope, delay, saturation)
    if isinstance(controller, Uncertain | Law):
        turned = continuous_controller(controller) if isinstance(controller, Law) else controller
        return star(P, _within_envelope(turned, P)[0], turned.n_inputs, turned.n_outputs)
    K = as_continuous("the controller", controller)
    if not scheduled:
        return close_loop(P, K)
    n, dynamics = K.order, rotation(_airframe(problem)[2], envelope)
    excess = (dynamics + -dynamics.nominal_system().D) @ np.eye(9, 6)  # what A(rho) adds to hover's
    system = np.block([[K.A, K.B], [K.C, K.D]]) + np.eye(n + K.n_outputs, 6) @ excess @ np.eye(6, n + K.n_inputs)
    return star(P, system_from_matrix(system, n), K.n_inputs, K.n_outputs)


def law_rounding(
    problem: Interconnection,
    controller: LinearSystem | Uncertain | Law,
    envelope: Envelope,
    loop: Uncertain,
    *,
    delay: Delay | None = None,
    saturation: float | None = None,
) -> dict[str, RationalMatrix] | None:
    """Return how far rounding moved the numbers of the `attitude_loop` of a law; `None` if the controller is none."""
    if not isinstance(controller, Law):
        return None
    P = _driven_plant(problem, envelope, delay, saturation)
    turned, shares = _within_envelope(continuous_controller(controller), P)
    return loop_radius(P, turned, sampled_controller(controller)[0], shares, loop)


def _driven_plant(
    problem: Interconnection, envelope: Envelope, delay: Delay | None, saturation: float | None
) -> Uncertain:
    """Return the `attitude_plant` behind the parts of the command's path."""
    P = attitude_plant(problem, envelope)
    if delay is None and saturation is None:
        return P
    return P @ append(np.eye(P.n_inputs - problem.n_con), _command_path(problem.n_con, delay, saturation))


def _within_envelope(K: Uncertain, P: Uncertain) -> tuple[Uncertain, list[float]]:
    """Return a scheduled controller with its parameters normalised to the plant's ranges, about 0 as its own.

    The share of the controller's own range follows for each of its channels.

    Raises
    ------
    ValueError
        If a parameter is none of the plant's, or has a smaller range: there the controller holds it.
    """
    known = {block.name: block for block in P.blocks if isinstance(block, RealBlock)}
    blocks, shares = [], [1.0] * K.n_w
    for block, at in zip(K.blocks, rows(K.blocks), strict=True):
        plant = known.get(block.name)
        if plant is None or not isinstance(block, RealBlock):
            raise ValueError(f"the controller's block '{block.name}' is no parameter of the plant")
        share = plant.high / block.high
        if share > 1.0 + _SAME_RANGE:
            ends = f"up to {block.high:.6g}, the envelope is {plant.high:.6g}"
            raise ValueError(f"the controller is scheduled on '{block.name}' {ends}")
        blocks.append(replace(plant, repeats=block.repeats))
        shares[at] = [share] * block.repeats
    M, scale = K.M, np.append(shares, np.ones(K.n_inputs))
    scaled = Lti(A=M.A, B=M.B * scale, C=M.C, D=M.D * scale, dt=M.dt)
    return Uncertain(M=scaled, blocks=tuple(blocks)), shares


def attitude_plant(problem: Interconnection, envelope: Envelope) -> Uncertain:
    """Return the plant of a design problem, from (w, u) to (z, y), with exact rotation over the envelope."""
    leak, damping, inertia_B = _airframe(problem)
    dynamics = rotation(inertia_B, envelope)
    return connect(problem, {"airframe": uncertain_airframe(dynamics, leak=leak, rate_damping=damping)})


def _command_path(n: int, delay: Delay | None, saturation: float | None) -> Uncertain:
    """Return the path of `n` commands, with a full block for each of the `command_parts`."""
    path = as_uncertain(np.eye(n))
    if delay is not None:
        path = np.eye(n) + ultidyn("delay", n, n)
    if saturation is not None:
        path = (np.eye(n) - (1.0 - 1.0 / saturation) * np.eye(n) @ ultidyn("saturation", n, n)) @ path
    return path


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
    loop: Uncertain,
    multipliers: Multipliers | RateBoundedMultipliers | ConstrainedMultipliers,
    speeds: Sequence[float | None],
) -> dict[str, Any]:
    common = {"system": _matrices(loop), "coordinates": multipliers.coordinates.tolist()}
    if isinstance(multipliers, ConstrainedMultipliers):
        storage = {"P": multipliers.P.tolist(), "stability": multipliers.stability.tolist()}
        return {"kind": "constrained gain", **common, **storage, "blocks": list(multipliers.blocks)}
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


def _is_proven(evidence: dict[str, Any], derived: DerivedLoop | None = None) -> bool:
    try:
        return check_evidence(evidence, derived).accepted
    except Refusal:
        return False


def _residual(level: float, evidence: dict[str, Any]) -> float:
    """Return the least eigenvalue of the inequalities, in the coordinates of their Lyapunov matrix."""
    exact_level = Fraction(level)
    forms = (
        rate_bounded_inequalities(exact_level, evidence)
        if evidence["kind"] == "slow gain"
        else [gain_inequality(exact_level, evidence)]
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
