"""Goals of a structured controller: one soft goal to minimise, and hard goals to satisfy.

The value of a goal is a property of the closed loop divided by its limit; a hard goal is satisfied at values up to 1.
Norms are of a part of P's own channels (w, z), or of transfers of every loop. The latter are the sensitivity at the
plant's input or output, and noise on y to u.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.state_space import LinearSystem, Lti, as_lti, series

Indices = tuple[int, ...] | None
"""Indices of channels, from 0; `None` for all."""


class LoopLocation(Enum):
    """Location of a break in the loop."""

    INPUT = "plant input"
    """At the controls u."""
    OUTPUT = "plant output"
    """At the measurements y."""


class NormKind(Enum):
    """Measure of the size of a transfer."""

    PEAK = "H-infinity norm"
    """Largest gain over all frequencies."""
    RMS = "H2 norm"
    """Rms of the outputs for white noise of unit density at the inputs."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GainGoal:
    """A norm of a part of (w, z), such as the torque slew: `NormKind.RMS` of a suitable z of P."""

    name: str = "gain"
    """Name, unique among the goals."""
    limit: float = 1.0
    """[-] largest value; also divides the norm of a soft goal."""
    measure: NormKind = NormKind.PEAK
    """Kind of norm."""
    inputs: Indices = None
    """Channels of w."""
    outputs: Indices = None
    """Channels of z."""
    weight: LinearSystem | None = None
    """Filter on all outputs together, such as a differentiator with a lag."""


NORM = GainGoal()
"""The H-infinity norm from w to z: what is minimised unless another goal is given."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensitivityGoal:
    """The H-infinity norm of the sensitivity: Ms of one channel, or of several at once; or a line for each frequency.

    With a `corner` the line is that of systune's tracking, `(limit s + corner lowest) / (s + corner)`, and the value of
    the goal is the largest ratio to it. A response time of T needs a corner of 2 / T at the plant output. To reject
    disturbances by the factor a, take a `lowest` of 1 / a at its input.
    """

    name: str = "Ms"
    """Name, unique among the goals."""
    limit: float = 2.0
    """[-] largest value of Ms."""
    location: LoopLocation = LoopLocation.INPUT
    """Location of the break in the loop."""
    channels: Indices = None
    """Broken channels; the others stay closed."""
    corner: float | None = None
    """[rad/s] frequency below which the line falls from `limit` towards `lowest`; without it, it is `limit`."""
    lowest: float = 1e-3
    """[-] value of the line at frequency 0: the steady error to a step."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DiskMarginGoal:
    """The disk margin of several channels at once, from `|| S - I/2 ||`; for one channel exact."""

    name: str = "disk margin"
    """Name, unique among the goals."""
    minimum: float = 0.5
    """[-] least disk margin alpha."""
    location: LoopLocation = LoopLocation.INPUT
    """Location of the break in the loop."""
    channels: Indices = None
    """Channels that vary; the others do not."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RollOffGoal:
    """The closed loop's gain from noise on y to u, below a line that falls with frequency."""

    name: str = "roll-off"
    """Name, unique among the goals."""
    corner: float
    """[rad/s] frequency at which the line has the value `limit`."""
    limit: float = 1.0
    """[unit of u / unit of y] largest gain at the corner."""
    slope: int = 1
    """Order of the fall, 1 or 2; the weight levels off at 1000 times the corner."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StabilityGoal:
    """All poles of the controller left of `-margin`; of a sampled one, of size up to `exp(-margin dt)`."""

    name: str = "controller stability"
    """Name, unique among the goals."""
    margin: float = 0.0
    """[1/s] least distance of the controller's poles from the imaginary axis."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DecayGoal:
    """A minimum decay of the closed loop: all its poles decay at least as fast as `exp(-minimum t)`."""

    name: str = "decay"
    """Name, unique among the goals."""
    minimum: float
    """[1/s] least decay: the distance of the poles from the imaginary axis, or `-log|z| / dt` of a sampled loop."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoleRadiusGoal:
    """A bound on the size of the closed loop's poles, `|s|` or, of a sampled loop, `|z|`."""

    name: str = "pole radius"
    """Name, unique among the goals."""
    limit: float
    """[rad/s, or - of a sampled loop] largest size of a pole."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControllerSizeGoal:
    """A bound on the controller's matrix [A, B; C, D]; of a static one, on the gain K itself."""

    name: str = "|K|"
    """Name, unique among the goals."""
    limit: float
    """[-] largest value."""
    entries: bool = False
    """True to bound the size of each entry, False for the largest singular value."""


ChannelGoal = GainGoal | SensitivityGoal | DiskMarginGoal | RollOffGoal
"""A goal that is a norm of a transfer of the closed loop."""
Goal = ChannelGoal | StabilityGoal | DecayGoal | PoleRadiusGoal | ControllerSizeGoal
"""Any goal."""


def extract_channel(goal: ChannelGoal, P: Lti, n_meas: int, n_con: int, dt: float = 0.0) -> tuple[Lti, float]:
    """Return the generalised plant of the goal, and the largest value of its closed-loop norm.

    The plant of a loop with the sample time `dt` [s] is given, and returned, by its bilinear transform. A sampled H2
    norm becomes a continuous one behind a lag: `d theta = dt / (1 + (omega dt / 2)^2) d omega`. The line of a roll-off
    starts at its corner and falls with the transformed frequency, which is faster.

    Raises
    ------
    ValueError
        If a channel does not exist or a limit is not positive.
    """
    if isinstance(goal, GainGoal):
        return _extract_gain(goal, P, n_meas, n_con, dt), require_positive(goal.name, goal.limit)
    if isinstance(goal, RollOffGoal):
        disturbed = _noise_to_control(P, n_meas, n_con)
        weight = _roll_off_weight(goal, n_con, dt)
        return _apply_weight(disturbed, weight, n_meas), require_positive(goal.name, goal.limit)
    limit = goal.limit if isinstance(goal, SensitivityGoal) else 1.0 / require_positive(goal.name, goal.minimum)
    at_input = goal.location is LoopLocation.INPUT
    chosen = _resolve_indices(goal.name, goal.channels, range(n_con if at_input else n_meas))
    broken = (_inject_at_input if at_input else _inject_at_output)(P, n_meas, n_con, chosen)
    D = broken.D.copy()
    if isinstance(goal, DiskMarginGoal):  # the norm of S - I/2 bounds the disk margin
        D[: len(chosen), : len(chosen)] -= 0.5 * np.eye(len(chosen))
    system = Lti(A=broken.A, B=broken.B, C=broken.C, D=D)
    if isinstance(goal, SensitivityGoal) and goal.corner is not None:
        return _apply_weight(system, _inverse_of_line(goal, goal.corner, len(chosen), dt), n_meas), 1.0
    return system, require_positive(goal.name, limit)


def _extract_gain(goal: GainGoal, P: Lti, n_meas: int, n_con: int, dt: float) -> Lti:
    m1, p1 = P.n_inputs - n_con, P.n_outputs - n_meas
    w, z, u, y = range(m1), range(p1), range(m1, P.n_inputs), range(p1, P.n_outputs)
    inputs, outputs = _resolve_indices(goal.name, goal.inputs, w), _resolve_indices(goal.name, goal.outputs, z)
    part = P.subsystem([*outputs, *y], [*inputs, *u])
    if goal.weight is not None:
        weight = as_lti(goal.weight)
        if weight.dt != dt:
            raise ValueError(f"goal '{goal.name}' has a weight with the sample time {weight.dt} s, not {dt} s")
        part = _apply_weight(part, bilinear_transform(weight) if dt else weight, n_meas)
    if dt and goal.measure is NormKind.RMS:
        one = np.eye(len(outputs))
        lag = Lti(A=-2.0 / dt * one, B=2.0 / dt * one, C=np.sqrt(dt) * one, D=0.0 * one)
        part = _apply_weight(part, lag, n_meas)
    return part


def _inject_at_input(P: Lti, n_meas: int, n_con: int, chosen: list[int]) -> Lti:
    """Return the plant from (d, u) to (u + d, y) with d added to the chosen controls: the closed loop is S."""
    m1, p1 = P.n_inputs - n_con, P.n_outputs - n_meas
    B2, C2, D22 = P.B[:, m1:], P.C[p1:], P.D[p1:, m1:]
    pick = np.eye(n_con)[:, chosen]
    return Lti(
        A=P.A,
        B=np.hstack([B2 @ pick, B2]),
        C=np.vstack([np.zeros((len(chosen), P.order)), C2]),
        D=np.block([[np.eye(len(chosen)), pick.T], [D22 @ pick, D22]]),
    )


def _inject_at_output(P: Lti, n_meas: int, n_con: int, chosen: list[int]) -> Lti:
    """Return the plant from (d, u) to (y + d, y + d) with d added to the chosen measurements."""
    m1, p1 = P.n_inputs - n_con, P.n_outputs - n_meas
    B2, C2, D22 = P.B[:, m1:], P.C[p1:], P.D[p1:, m1:]
    pick = np.eye(n_meas)[:, chosen]
    return Lti(
        A=P.A,
        B=np.hstack([np.zeros((P.order, len(chosen))), B2]),
        C=np.vstack([pick.T @ C2, C2]),
        D=np.block([[np.eye(len(chosen)), pick.T @ D22], [pick, D22]]),
    )


def _noise_to_control(P: Lti, n_meas: int, n_con: int) -> Lti:
    """Return the plant from (noise on y, u) to (u, y)."""
    m1, p1 = P.n_inputs - n_con, P.n_outputs - n_meas
    return Lti(
        A=P.A,
        B=np.hstack([np.zeros((P.order, n_meas)), P.B[:, m1:]]),
        C=np.vstack([np.zeros((n_con, P.order)), P.C[p1:]]),
        D=np.block([[np.zeros((n_con, n_meas)), np.eye(n_con)], [np.eye(n_meas), P.D[p1:, m1:]]]),
    )


def _roll_off_weight(goal: RollOffGoal, width: int, dt: float) -> Lti:
    """Return `(s / corner)^slope` on each channel, with lags at 1000 times the corner."""
    if goal.slope not in (1, 2) or not goal.corner > 0.0:
        raise ValueError(f"goal '{goal.name}' has slope {goal.slope} and corner {goal.corner}: 1 or 2, and positive")
    corner = _warped_corner(goal.name, goal.corner, dt)
    fast, identity = 1e3 * corner, np.eye(width)
    lead = Lti(A=-fast * identity, B=fast * identity, C=-1e3 * identity, D=1e3 * identity)
    return lead if goal.slope == 1 else series(lead, lead)


def _inverse_of_line(goal: SensitivityGoal, corner: float, width: int, dt: float) -> Lti:
    """Return the inverse of the line of a sensitivity, on each channel."""
    if not (corner > 0.0 and 0.0 < goal.lowest < goal.limit < np.inf):
        given = f"corner {corner:g}, lowest {goal.lowest:g} and limit {goal.limit:g}"
        raise ValueError(f"goal '{goal.name}' has {given}: the corner must be positive, and 0 < lowest < limit")
    fast, one = _warped_corner(goal.name, corner, dt), np.eye(width)
    slow = fast * goal.lowest / goal.limit
    return Lti(A=-slow * one, B=one, C=(fast - slow) / goal.limit * one, D=one / goal.limit)


def _warped_corner(name: str, corner: float, dt: float) -> float:
    """Return the frequency [rad/s] of the bilinear transform of a loop with the sample time `dt` [s], 0 continuous."""
    if dt and not corner * dt < np.pi:
        raise ValueError(f"goal '{name}' has its corner at {corner:g} rad/s, beyond half the sample rate")
    return float(2.0 / dt * np.tan(0.5 * corner * dt) if dt else corner)


def _apply_weight(P: Lti, weight: Lti, n_meas: int) -> Lti:
    """Return `P` with the filter `weight` on all outputs but the last `n_meas`."""
    p1 = P.n_outputs - n_meas
    if weight.n_inputs != p1:
        raise ValueError(f"the weight has {weight.n_inputs} inputs, must have {p1}, one for each output")
    beside = Lti(
        A=weight.A,
        B=np.hstack([weight.B, np.zeros((weight.order, n_meas))]),
        C=np.vstack([weight.C, np.zeros((n_meas, weight.order))]),
        D=np.block([[weight.D, np.zeros((weight.n_outputs, n_meas))], [np.zeros((n_meas, p1)), np.eye(n_meas)]]),
    )
    return series(P, beside)


def _resolve_indices(name: str, indices: Indices, known: range) -> list[int]:
    if indices is None:
        return list(known)
    if not indices or [k for k in indices if k not in known]:
        raise ValueError(f"goal '{name}' names channels {indices}, there are {len(known)}, counted from 0")
    return list(indices)


def require_positive(name: str, limit: float) -> float:
    """Return the limit of the goal `name`; raises ValueError if it is not positive."""
    if not (np.isfinite(limit) and limit > 0.0):
        raise ValueError(f"goal '{name}' has the limit {limit!r}, must be positive")
    return limit
