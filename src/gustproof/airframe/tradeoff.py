"""Least attitude error in turbulence against the sensitivity peak, at a given torque slew: a convex trade-off.

Every linear law that stabilises an axis is the optimal one of `gustproof.airframe.limits` closed by a stable `Q`
(Youla's parameter), in which closed-loop responses are affine. So mean-square error and slew are convex quadratics in
`Q`'s coefficients, and a bound on the sensitivity at a frequency is a second-order cone.

`Q` is restricted to the span of a constant and n orthonormal functions. Each optimum is then an actual law, with the
performance computed by `controller_performance`. As n grows, the curve falls towards the limit of all linear laws. The
purpose of these laws is to show this limit.

References
----------
S. Boyd, C. Barratt, Linear Controller Design: Limits of Performance, Prentice Hall 1991, chapters 7 and 15.
B. Ninness, F. Gustafsson, A unifying construction of orthonormal bases for system identification, IEEE Transactions on
Automatic Control 42 (1997), 515-521.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
import scipy

from gustproof.airframe.covariance import (
    AxisModel,
    augmented_axis,
    controller_performance,
    mean_second_moments,
    pool_axes,
)
from gustproof.airframe.limits import central_controller, feedback_gain, output_feedback_limit
from gustproof.errors import DesignError
from gustproof.law.form import Matrix
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, lft, series

_POLES = np.geomspace(1.0, 300.0, 12)
"""[rad/s] poles of the functions, used cyclically: from the gusts to beyond the fastest loop the delay permits."""
_POINTS = 150
"""Number of frequencies, evenly spaced in the logarithm, at which the sensitivity is constrained."""
_LOWEST_OMEGA = 0.5
"""[rad/s] lowest of these frequencies: below it, gusts alone make every law's sensitivity small."""
_GRID_MARGIN = 5e-4
"""[-] share of the peak reserved for a rise of the sensitivity between two frequencies."""
_ROUNDING = 1e-14
"""[-] second moments below this share of the largest count as rounding."""
_TOLERANCE = 1e-3
"""[-] relative excess of peak or slew above which a solution is rejected."""
_RETRY_EXCESS = 1e-2
"""[-] relative excess of the peak below which it is attributed to the space between two frequencies."""
_ROUNDS = 3
"""Number of programs, each tightened by the excess of the previous one between two frequencies."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TradeOff:
    """One point of the trade-off, with the laws that achieve it."""

    sensitivity_peak: float
    """[-] largest sensitivity peak of the axes."""
    rmse: float
    """[rad] root mean square attitude over the flight, of all axes."""
    slew: float
    """[N*m/s] rms torque slew, of all axes."""
    controllers: tuple[Lti, ...]
    """Law of each axis, gyro [rad/s] to command [N*m]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Axis:
    """One axis as a function of the coefficients q of `Q`, (k,)."""

    error: Matrix
    """(., 1 + k) `|error (1, q)|` is the rms attitude [rad]."""
    change: Matrix
    """(., 1 + k) likewise the rms change of command [N*m]."""
    sensitivity: ComplexMatrix
    """(f, 1 + k) likewise the sensitivity [-] at each frequency."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearLaws:
    """All linear laws of the axes with `Q` in a span: the domain of `minimize_error`."""

    models: tuple[AxisModel, ...]
    """The axes in turbulence."""
    weight: float
    """[rad^2/(N*m)^2] weight of slew for the law at `Q` = 0."""
    bank: Lti
    """System from one input to itself and to each orthonormal function of it."""
    axes: tuple[_Axis, ...]
    """The axes as functions of the coefficients."""

    def minimize_error(self, sensitivity_peak: float, slew: float) -> TradeOff:
        """Return the point of least error, from one cone program that shares the slew optimally among the axes.

        The sensitivity peak [-] of each axis is at most `sensitivity_peak` > 1, the rms torque slew pooled over the
        axes at most `slew` [N*m/s]. The figures are those of the resulting laws, not of the solver.

        Raises
        ------
        DesignError
            If the limits are too tight for this vehicle, or the solution does not satisfy them.
        """
        limit = sensitivity_peak * (1.0 - _GRID_MARGIN)
        for _ in range(_ROUNDS):
            coefficients = _optimize(self.axes, limit, slew * self.bank.dt)
            laws = tuple(
                lft(central_controller(m, self.weight), _combine(self.bank, q))
                for m, q in zip(self.models, coefficients, strict=True)
            )
            axes = [controller_performance(model, law) for model, law in zip(self.models, laws, strict=True)]
            (rmse, achieved), worst = pool_axes(axes), max(axis.sensitivity_peak for axis in axes)
            point = TradeOff(sensitivity_peak=worst, rmse=rmse, slew=achieved, controllers=laws)
            excess = point.sensitivity_peak / sensitivity_peak
            if excess <= 1.0 + _TOLERANCE and point.slew <= (1.0 + _TOLERANCE) * slew:
                return point
            if not excess <= 1.0 + _RETRY_EXCESS:
                break
            limit /= excess
        raise DesignError(
            f"no law found at sensitivity peak {sensitivity_peak} and slew {slew} N*m/s: "
            f"the best had {point.sensitivity_peak:.4f} and {point.slew:.4f}"
        )


def linear_laws(models: Sequence[AxisModel], *, functions: int = 36, around: float = 20.0) -> LinearLaws:
    """Return the laws spanned by a constant and a number of orthonormal functions, added to an optimal law.

    `around` [N*m/s] is the slew of that optimal law. With infinitely many functions the results would not depend on it.
    With the default number they vary by less than .1 % for values from 2 to 100 N*m/s.

    Raises
    ------
    DesignError
        If no law holds attitude at slew `around`.
    """
    weight, dt = output_feedback_limit(models, around).weight, models[0].plant.dt
    bank = orthonormal_basis(np.exp(-np.resize(_POLES, functions) * dt), dt)
    axes = tuple(_axis(model, weight, bank) for model in models)
    return LinearLaws(models=tuple(models), weight=weight, bank=bank, axes=axes)


def orthonormal_basis(poles: Matrix, dt: float) -> Lti:
    """Return the system from one input to itself and to an orthonormal function of it for each pole (n,) [-].

    Takenaka and Malmquist's functions: a low-pass of each pole behind the all-passes of the preceding poles.
    """
    n = poles.size
    A, B = np.zeros((n, n)), np.zeros((n, 1))
    signal = np.append(np.zeros(n), 1.0)  # in the chain of all-passes, as a row over (states, input)
    for i, pole in enumerate(poles):
        size = math.sqrt(1.0 - pole**2)
        A[i], B[i] = size * signal[:n] + pole * np.eye(n)[i], size * signal[n]
        signal = -pole * signal
        signal[i] += size
    return Lti(A=A, B=B, C=np.eye(n + 1, n, -1), D=np.eye(n + 1, 1), dt=dt)


def _axis(model: AxisModel, weight: float, bank: Lti) -> _Axis:
    error, change = (_moments(model, weight, bank, output) for output in (0, 1))
    omega = np.geomspace(_LOWEST_OMEGA, 0.999 * math.pi / bank.dt, _POINTS)
    return _Axis(error=_root(error), change=_root(change), sensitivity=_sensitivity(model, weight, bank, omega))


def _moments(model: AxisModel, weight: float, bank: Lti, output: int) -> Matrix:
    """Return the second moments (1 + k, 1 + k) of an output over the flight: at `Q` = 0, and of each function.

    `Q` is scalar, so its functions may act after the plant, on the response of the output to the innovation.
    """
    flight, central = augmented_axis(model), central_controller(model, weight)
    # inputs: noises, then the controller's outputs: command and innovation
    columns = np.hstack([flight.D, np.zeros((3, 1))])[[output, 0, 2]]
    columns[1] = np.eye(1, columns.shape[1], columns.shape[1] - 1)
    B = np.hstack([flight.B, np.zeros((flight.order, 1))])
    C = np.vstack([flight.C[output], np.zeros(flight.order), flight.C[2]])
    P = Lti(A=flight.A, B=B, C=C, D=columns, dt=flight.dt)
    whole = lft(P, central.subsystem(slice(0, 2), slice(0, 1)))  # noises to output and innovation
    after = series(_command_response(flight, weight, flight.C[output], flight.D[output, -1]), bank)
    B, C = np.hstack([np.zeros((after.order, 1)), after.B]), np.vstack([np.zeros(after.order), after.C])
    D = np.block([[np.eye(1), np.zeros((1, 1))], [np.zeros((after.n_outputs, 1)), after.D]])
    both = Lti(A=after.A, B=B, C=C, D=D, dt=flight.dt)
    return mean_second_moments([model], series(whole, both))


def _command_response(flight: Lti, weight: float, C: Matrix, D: float) -> Lti:
    """Return the response of the output `C x + D u` to an additional command, under the optimal law."""
    B, F = flight.B[:, -1:], feedback_gain(flight, weight)
    return Lti(A=flight.A - B @ F, B=B, C=C - D * F, D=np.array([[D]]), dt=flight.dt)


def _sensitivity(model: AxisModel, weight: float, bank: Lti, omega: Matrix) -> ComplexMatrix:
    """Return the sensitivity at the plant's input, (f, 1 + k): at `Q` = 0, and the increment of each function."""
    flight = augmented_axis(model)
    gyro = Lti(A=flight.A[1:, 1:], B=flight.B[1:, -1:], C=flight.C[2:, 1:], D=np.zeros((1, 1)), dt=flight.dt)
    G, J = gyro.response(omega)[:, 0, 0], central_controller(model, weight).response(omega)
    S = 1.0 / (1.0 - G * J[:, 0, 0])
    added = S * J[:, 0, 1] * J[:, 1, 0] * G * S
    return np.hstack([S[:, None], added[:, None] * bank.response(omega)[:, :, 0]])


def _optimize(axes: Sequence[_Axis], peak: float, change: float) -> list[Matrix]:
    """Return the coefficients of each axis with the least error at a peak and a pooled change of command."""
    k = axes[0].error.shape[1] - 1
    unknowns = k * len(axes) + 1  # the last one is the error to minimise
    scale = math.sqrt(sum(float(np.sum(axis.error[:, 0] ** 2)) for axis in axes))
    blocks = [
        _cone([axis.error / scale for axis in axes], np.eye(unknowns)[-1], 0.0),
        _cone([axis.change / (change * math.sqrt(len(axes))) for axis in axes], np.zeros(unknowns), 1.0),
    ]
    for i, axis in enumerate(axes):
        for row in axis.sensitivity:
            part = np.zeros((2, 1 + k))
            part[0], part[1] = row.real, row.imag
            parts = [part if j == i else np.zeros((0, 1 + k)) for j in range(len(axes))]
            blocks.append(_cone(parts, np.zeros(unknowns), peak))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    P, q = scipy.sparse.csc_matrix((unknowns, unknowns)), np.eye(unknowns)[-1]
    A = scipy.sparse.csc_matrix(np.vstack([part for part, _ in blocks]))
    b, cones = np.concatenate([part for _, part in blocks]), [clarabel.SecondOrderConeT(b.size) for _, b in blocks]
    solution = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
    coefficients = np.array(solution.x[:-1], dtype=np.float64)
    if not np.all(np.isfinite(coefficients)):
        raise DesignError(f"no law found at sensitivity peak {peak:.4g}: solver status {solution.status}")
    return list(coefficients.reshape(len(axes), k))


def _cone(parts: Sequence[Matrix], slope: Matrix, offset: float) -> tuple[Matrix, Matrix]:
    """Return A and b of the cone |parts times (1, q)| <= slope x + offset, in the solver's form `b - A x`."""
    k = parts[0].shape[1] - 1
    A, b = [-slope[None]], [np.array([offset])]
    for i, part in enumerate(parts):
        rows = np.zeros((part.shape[0], slope.size))
        rows[:, i * k : (i + 1) * k] = -part[:, 1:]
        A.append(rows)
        b.append(part[:, 0])
    return np.vstack(A), np.concatenate(b)


def _root(moments: Matrix) -> Matrix:
    """Return `R` with `R' R` equal to the moments up to rounding."""
    values, vectors = np.linalg.eigh(0.5 * (moments + moments.T))
    kept = values > _ROUNDING * values[-1]
    return np.asarray((vectors[:, kept] * np.sqrt(values[kept])).T)


def _combine(bank: Lti, q: Matrix) -> Lti:
    return Lti(A=bank.A, B=bank.B, C=q[None] @ bank.C, D=q[None] @ bank.D, dt=bank.dt)
