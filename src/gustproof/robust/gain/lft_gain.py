"""Certified L2 gain of any loop with real parameters, delays, sectors and slopes."""

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any, cast

import numpy as np

from gustproof.checker.directed_rounding import print_up
from gustproof.checker.dissipation import gain_inequality, rate_bounded_inequalities
from gustproof.checker.evidence import DerivedLoop, check_evidence, is_name
from gustproof.checker.evidence_types import AnyGainEvidence, SystemMatrices
from gustproof.checker.rational import RationalMatrix, multiply, to_rational, transpose
from gustproof.checker.system import Refusal
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.gain.constrained_multipliers import ConstrainedMultipliers, constrained_multipliers
from gustproof.robust.gain.linear_members import worst_member
from gustproof.robust.gain.loop_units import Found, in_units, search_units, to_loop_units
from gustproof.robust.gain.multipliers import Multipliers, best_multipliers
from gustproof.robust.gain.parts import Delay, Part
from gustproof.robust.gain.rate_bounded_multipliers import RateBoundedMultipliers, rate_bounded_multipliers
from gustproof.robust.gain.worst_schedule import worst_schedule, worst_triangle_schedule
from gustproof.robust.lti.state_space import Matrix, gain, lft
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import RealBlock
from gustproof.robust.uncertain.units import ChannelUnits

_DECAY = 1e-9
"""[rad/s] least decay of a loop that counts as stable, above rounding."""
_MARGINS = (1e-6, 1e-5, 1e-4, 1e-3)
"""[-] relative margins above the solver's level, tried in turn: rounding of the multipliers needs some."""


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
    proved of all loops within these distances too. Multipliers are searched in balanced units of states and channels;
    the certificate states the loop in its own, and its multipliers are brought back without rounding. So it is the same
    claim, and the check sees the loop as given. `signals` and `scope` are the statement's words for the loop's
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
    See `gustproof.checker.quadratic_constraints`.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import Delay, Uncertain, certify_lft, ultidyn
    >>> M = ss(-3.0, [-2.0, 1.0], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
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
    evidence = cast(AnyGainEvidence, {})
    if multipliers is not None:
        evidence = cast(AnyGainEvidence, _evidence(loop, multipliers, bounds))
        candidates = [multipliers.level * (1.0 + margin) for margin in _MARGINS] if level is None else [level]
        derived = None if radius is None else derived_loop(loop, speeds, parts, radius)
        wanted, proven = _first_proven(candidates, evidence, derived)
    claim = "is not bounded by these multipliers" if wanted is None else f"is below {print_up(wanted)}"
    return Certificate(
        statement=f"the L2 gain {signals} {claim} {scope}",
        gain=wanted,
        lower_bound=lower_bound(loop, speeds, parts),
        proven=proven,
        assumes=assumes,
        evidence=evidence,
        residual=None if wanted is None or not evidence else _residual(wanted, evidence, search_units(loop).channels),
    )


def _find_multipliers(
    loop: Uncertain, speeds: Mapping[str, float] | None, parts: Mapping[str, Part] | None
) -> Found | None:
    if not loop.M.order:
        raise ValueError("the loop has no states: its gain over Delta(t) is that over constant ones, use wcgain")
    if loop.M.dt:
        raise ValueError("the loop must be continuous and stable at Delta = 0")
    units, bounds = search_units(loop), _speed_bounds(loop, speeds)
    balanced = in_units(loop, units)
    found: Found | None
    if parts:
        found = constrained_multipliers(balanced, parts)
    else:
        found = best_multipliers(balanced) if speeds is None else rate_bounded_multipliers(balanced, bounds)
    return None if found is None else to_loop_units(found, loop, units, [bound is not None for bound in bounds])


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
    units = search_units(loop)
    return units.channels.output * _lower_bound(in_units(loop, units), speeds, parts or {})


def _lower_bound(loop: Uncertain, speeds: Mapping[str, float] | None, parts: Mapping[str, Part]) -> float:
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
        worst = complex(max(loop.member({name: np.eye(shape[0])}).poles(), key=lambda pole: pole.real))
        if worst.real > -_DECAY:
            raise ValueError(
                f"with slope 1 of '{name}' the loop has a pole at {worst:.3g} rad/s: no global L2 gain exists; "
                "a saturated loop needs a plant and a controller that are stable alone"
            )


def _matrices(loop: Uncertain) -> SystemMatrices:
    return {"A": loop.M.A.tolist(), "B": loop.M.B.tolist(), "C": loop.M.C.tolist(), "D": loop.M.D.tolist()}


def _speed_bounds(loop: Uncertain, speeds: Mapping[str, float] | None) -> list[float | None]:
    """Return the bound on the speed of each block; `None` without one."""
    names, bounds = [block.name for block in loop.blocks], speeds or {}
    if odd := [name for name in names if not is_name(name)]:
        raise ValueError(
            f"block '{odd[0]}': a certificate names blocks by ASCII letters, digits, '_', '-' and '.' alone"
        )
    if unknown := sorted(set(bounds) - set(names)):
        raise ValueError(f"speeds name '{unknown[0]}', there are {', '.join(names)}")
    return [bounds.get(name) for name in names]


def _first_proven(
    candidates: Sequence[float], evidence: AnyGainEvidence, derived: DerivedLoop | None
) -> tuple[float, bool]:
    """Return the first candidate proven of the evidence's loop, and of one derived, and True; or the last and False.

    It becomes the evidence's level.
    """
    for candidate in candidates:
        evidence["level"] = candidate
        if _is_proven(evidence) and (derived is None or _is_proven(evidence, derived)):
            return candidate, True
    return candidates[-1], False


def _evidence(
    loop: Uncertain,
    multipliers: Multipliers | RateBoundedMultipliers | ConstrainedMultipliers,
    speeds: Sequence[float | None],
) -> dict[str, object]:
    """Return the evidence but for its level."""
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


def _is_proven(evidence: AnyGainEvidence, derived: DerivedLoop | None = None) -> bool:
    try:
        return check_evidence(evidence, derived).accepted
    except Refusal:
        return False


def _residual(level: float, evidence: AnyGainEvidence, units: ChannelUnits) -> float:
    """Return the least eigenvalue of the inequalities, in the coordinates of their Lyapunov matrix and other units."""
    exact_level = Fraction(level)
    forms = (
        rate_bounded_inequalities(exact_level, evidence)
        if evidence["kind"] == "slow gain"
        else [gain_inequality(exact_level, evidence)]
    )
    inverse = np.linalg.inv(np.array(evidence["coordinates"], dtype=np.float64))
    least = []
    for form in forms:
        change = np.eye(len(form.middle))
        change[: len(inverse), : len(inverse)] = inverse
        at = range(len(inverse), len(inverse) + len(units.w))
        change[at, at] = units.w
        change /= units.output
        moved = to_rational(change.tolist())
        matrix = np.array(multiply(transpose(moved), multiply(form.middle, moved)), dtype=np.float64)
        least.append(float(np.linalg.eigvalsh(matrix)[0]))
    return min(least)
