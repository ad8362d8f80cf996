"""One model and a weight that cover a family of models: `ucover`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.gain_curve import beside_resonances
from gustproof.robust.lti.state_space import ComplexMatrix, LinearSystem, Lti, Matrix, as_lti, gain
from gustproof.robust.mu.minimum_phase import MinimumPhase, fit_factors
from gustproof.robust.shown import Shown
from gustproof.robust.uncertain.elements import ultidyn
from gustproof.robust.uncertain.uncertain_system import Uncertain, stack

if TYPE_CHECKING:
    import control

Form = Literal["additive", "input", "output"]
"""Place of the unknown: see `ucover`."""

_PER_DECADE = 40
"""Frequencies at which the models are compared; the cover is checked at four times as many."""
_REACH = 100.0
"""[-] factor by which frequencies go beyond the poles and zeros of all models."""
_FLOOR = 1e-6
"""[-] distance, relative to the largest, below which the fit does not follow."""
_ROUNDS = 40
"""Most changes of the fit's target that bring the weight down to the distance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Cover(Shown):
    """A nominal model, a weight, and the uncertain model of both (MATLAB: `usys`, `info.W1`)."""

    model: Uncertain
    """Uncertain model with one full block "unmodelled", which holds every member of the family."""
    nominal: "control.StateSpace"
    """Model at Delta = 0."""
    weight: "control.StateSpace"
    """Scalar, stable, with a stable inverse; the same on every channel."""
    omega: Matrix
    """(k,) [rad/s] frequencies at which the members were compared with the weight."""
    distance: Matrix
    """(k,) [-] largest distance of a member from the nominal model, in the units of the form."""
    excess: float
    """[-] largest ratio of weight to distance where the distance is within 1 % of its largest; 1 is tight."""

    def lines(self) -> list[str]:
        """Return the largest distance of the family, and how tight the weight is there."""
        k = int(np.argmax(self.distance))
        where = f"{self.distance[k]:.4g} at {self.omega[k]:.4g} rad/s"
        weight = f"weight: {as_lti(self.weight).describe_size()}, {self.excess:.4g} times the distance there"
        return ["Cover", f"model: {self.model.lines()[0].removeprefix('Uncertain: ')}", f"distance: {where}", weight]


def ucover(models: Sequence[LinearSystem], nominal: LinearSystem, order: int, *, form: Form = "input") -> Cover:
    """Return an uncertain model that covers a family of models (MATLAB: `ucover`).

    Every member is the nominal model G with an unknown of H-infinity norm at most 1:

    - `additive`: `G + w Delta`;
    - `input`: `G (I + w Delta)`, for G with at least as many outputs as inputs, of full rank;
    - `output`: `(I + w Delta) G`, for G with at most as many outputs as inputs, of full rank.

    The weight w is fitted from above to the largest distance, over frequency. The cover is checked at four times as
    many frequencies as the fit, 160 a decade, and beside each pole. A sample may miss some thousandths.

    Parameters
    ----------
    models
        Members, of one size, sample time and number of unstable poles.
    nominal
        Model at the centre.
    order
        Number of states of the weight.
    form
        See above.

    Raises
    ------
    ValueError
        If there are no models, sizes or sample times differ, or the order or form is out of range.
    DesignError
        If a member has another number of unstable poles than the nominal model, so that no stable unknown leads to it.
        If the nominal model loses rank, or all members equal it.

    References
    ----------
    H. Hindi, C.-Y. Seong, S. Boyd, Computing optimal uncertainty models from frequency domain data, CDC 2002,
    2898-2905 (the problem). S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd edition, Wiley 2005,
    section 7.4.3.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import ucover
    >>> family = [ss(-1.0 / lag, 1.0 / lag, 1.0, 0.0) for lag in (0.8, 0.9, 1.1, 1.3)]
    >>> cover = ucover(family, ss(-1.0, 1.0, 1.0, 0.0), 1)
    >>> f"{abs(cover.weight(0.01j)):.3f}, {abs(cover.weight(100j)):.3f}"
    '0.003, 0.250'
    """
    members, centre = [as_lti(model) for model in models], as_lti(nominal)
    _check_family(members, centre, order, form)
    continuous = [bilinear_transform(model) if model.dt else model for model in (centre, *members)]
    omega = _grid(continuous, _PER_DECADE)
    distance = _distance(continuous, omega, form)
    if not np.any(distance > 0.0):
        raise DesignError("every member equals the nominal model: there is nothing to cover")
    weight = _fit_from_above(omega, np.maximum(distance, _FLOOR * np.max(distance)), order)
    fine = _grid(continuous, 4 * _PER_DECADE)
    checked = _distance(continuous, fine, form)
    size = np.exp(weight.log_response(fine).real)
    factor = max(1.0, float(np.max(checked / size)))
    system = _in_time_of(centre, _scale(weight, factor))
    close = checked >= 0.99 * np.max(checked)
    warped = 2.0 / centre.dt * np.arctan(0.5 * centre.dt * fine) if centre.dt else fine
    return Cover(
        model=_uncertain(centre, system, form),
        nominal=centre.to_control(),
        weight=system.to_control(),
        omega=np.asarray(warped, dtype=np.float64),
        distance=checked,
        excess=float(np.max(factor * size[close] / checked[close])),
    )


def _check_family(members: list[Lti], centre: Lti, order: int, form: Form) -> None:
    if not members:
        raise ValueError("there are no models")
    if order < 0 or form not in ("additive", "input", "output"):
        raise ValueError(f"order {order} or form '{form}' is out of range")
    for number, model in enumerate(members):
        if model.D.shape != centre.D.shape or model.dt != centre.dt:
            raise ValueError(f"model {number} has not the size or sample time of the nominal model")
        if _unstable_poles(model) != _unstable_poles(centre):
            raise DesignError(
                f"model {number} has {_unstable_poles(model)} unstable poles, the nominal model "
                f"{_unstable_poles(centre)}: no stable unknown leads from one to the other"
            )


def _unstable_poles(model: Lti) -> int:
    poles = model.poles()
    return int(np.sum(np.abs(poles) >= 1.0) if model.dt else np.sum(poles.real >= 0.0))


def _grid(models: list[Lti], per_decade: int) -> Matrix:
    """Return frequencies [rad/s] around all poles that are not 0, and beside resonances, and notches of the first."""
    poles = np.concatenate([model.poles() for model in models])
    speeds = np.abs(poles)
    speeds = speeds[speeds > 1e-9 * np.max(speeds, initial=0.0)]
    low, high = float(np.min(speeds, initial=1.0)) / _REACH, float(np.max(speeds, initial=1.0)) * _REACH
    even = np.geomspace(low, high, round(per_decade * np.log10(high / low)))
    centre = models[0]
    zeros = centre.zeros() if centre.n_inputs == centre.n_outputs else poles[:0]
    beside = beside_resonances(np.concatenate([poles, zeros]))
    return np.union1d(even, beside[(beside > low) & (beside < high)])


def _distance(models: list[Lti], omega: Matrix, form: Form) -> Matrix:
    """Return the largest distance of a member from the first model, (k,), at k frequencies."""
    centre = models[0].response(omega)
    off = [model.response(omega) - centre for model in models[1:]]
    if form == "output":
        centre, off = centre.swapaxes(1, 2), [part.swapaxes(1, 2) for part in off]
    if form != "additive":
        off = [_divide(centre, part) for part in off]
    distances = [np.linalg.norm(part, 2, axis=(1, 2)) for part in off]
    return np.asarray(np.max(distances, axis=0), dtype=np.float64)


def _divide(centre: ComplexMatrix, off: ComplexMatrix) -> ComplexMatrix:
    """Return E with `centre E = off`, (k, m, m), or raise an error if there is none."""
    E = np.asarray(np.linalg.pinv(centre, rcond=1e-12) @ off)
    missed = np.linalg.norm(centre @ E - off, axis=(1, 2))
    if np.any(missed > 1e-6 * np.linalg.norm(off, axis=(1, 2)) + 1e-300):
        raise DesignError("the nominal model loses rank, or lacks inputs or outputs: another form may do")
    return E


def _fit_from_above(omega: Matrix, distance: Matrix, order: int) -> MinimumPhase:
    """Return a weight never below the distance at `omega`, and little above it.

    The logarithm is fitted, and its target raised where the fit lies below.
    """
    goal, wanted = np.log(distance), np.log(distance)
    best, least = None, np.inf
    for _ in range(_ROUNDS):
        weight, _ = fit_factors(omega, (2.0 * wanted).astype(np.complex128), np.ones(omega.size), order)
        below = goal - weight.log_response(omega).real
        lift = max(float(np.max(below)), 0.0)
        cost = float(np.mean(np.exp(goal) * np.exp(lift - below)) / np.mean(np.exp(goal))) * np.exp(lift)
        if best is None or cost < least:
            best, least = _lift(weight, lift), cost
        if lift <= 1e-3:
            break
        wanted = wanted + 0.5 * np.maximum(below, 0.0)
    assert best is not None
    return best


def _lift(weight: MinimumPhase, lift: float) -> MinimumPhase:
    theta = weight.theta.copy()
    theta[-1] += lift
    return MinimumPhase(order=weight.order, theta=theta)


def _scale(weight: MinimumPhase, factor: float) -> Lti:
    return _lift(weight, float(np.log(factor))).system()


def _in_time_of(centre: Lti, weight: Lti) -> Lti:
    """Return a continuous weight in the time of `centre`: by the bilinear transform, if that is discrete."""
    if not centre.dt:
        return weight
    half = 0.5 * centre.dt
    M = np.linalg.inv(np.eye(weight.order) - half * weight.A)
    root = np.sqrt(centre.dt)
    return Lti(
        A=M @ (np.eye(weight.order) + half * weight.A),
        B=root * M @ weight.B,
        C=root * weight.C @ M,
        D=weight.D + half * weight.C @ M @ weight.B,
        dt=centre.dt,
    )


def _uncertain(centre: Lti, weight: Lti, form: Form) -> Uncertain:
    """Return the nominal model with the weighted unknown in its place."""
    p, m = centre.n_outputs, centre.n_inputs
    n_out, n_in = {"additive": (p, m), "input": (m, m), "output": (p, p)}[form]
    unknown = stack(*[weight] * n_out) @ ultidyn("unmodelled", n_out, n_in)
    if form == "additive":
        return unknown + centre
    around = unknown + gain(np.eye(n_in), centre.dt)
    return Uncertain(M=centre) @ around if form == "input" else around @ Uncertain(M=centre)
