"""Least attitude error in turbulence against the sensitivity peak, at a given torque slew: a convex trade-off.

Every linear law that stabilises an axis is the optimal one of `gustproof.performance.limits` closed by a stable `Q`
(Youla's parameter), in which closed-loop responses are affine. So mean-square error and slew are convex quadratics in
`Q`'s coefficients, and a bound on the sensitivity at a frequency is a second-order cone. With `Q` in the span of a
constant and n orthonormal functions the optimum is a law that is had, as exactly as `axis_figures` foretells it, and
the curve falls towards the limit of all linear laws as n grows; what these laws are for is to show where that is.

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
import scipy.sparse

from gustproof.errors import DesignError
from gustproof.law.form import Matrix
from gustproof.lti.state_space import ComplexMatrix, Lti, lft, series
from gustproof.performance.covariance import AxisModel, augmented_axis, controller_performance, mean_second_moments
from gustproof.performance.limits import central_controller, feedback_gain, output_feedback_limit

_POLES = np.geomspace(1.0, 300.0, 12)
"""[rad/s] poles of the functions, taken in turn: from the gusts to beyond the fastest loop that the delay allows."""
_POINTS = 150
"""Frequencies, evenly spaced in the logarithm, at which the sensitivity is kept."""
_LOWEST_OMEGA = 0.5
"""[rad/s] the lowest of them: below it, gusts alone make every law's sensitivity small."""
_GRID_MARGIN = 5e-4
"""[-] share of the peak kept back for what the sensitivity may rise between two frequencies."""
_ROUNDING = 1e-14
"""[-] share of the largest second moment below which one is rounding."""
_TOLERANCE = 1e-3
"""[-] relative excess of peak or slew at which an answer of the solver is refused."""
_RETRY_EXCESS = 1e-2
"""[-] relative excess of the peak below which it is put down to what lies between two frequencies."""
_ROUNDS = 3
"""Programs, each with what the one before missed between two frequencies kept back too."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TradeOff:
    """One point of the trade-off, with the laws that have it."""

    sensitivity_peak: float
    """[-] largest of the axes, of the laws."""
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
    """Every linear law of the axes whose `Q` is in a span: what `least` looks among."""

    models: tuple[AxisModel, ...]
    """The axes, in the turbulence that counts."""
    weight: float
    """[rad^2/(N*m)^2] price of slew of the law at `Q` = 0."""
    bank: Lti
    """One input to itself and to each orthonormal function of it."""
    axes: tuple[_Axis, ...]
    """The axes as functions of the coefficients."""

    def least(self, sensitivity_peak: float, slew: float) -> TradeOff:
        """Return the point of least error, one cone program of all axes at once: the slew goes where it is worth most.

        The point is of laws, and its figures are the laws' own.

        Parameters
        ----------
        sensitivity_peak
            [-] largest sensitivity peak of each axis, above 1.
        slew
            [N*m/s] largest rms torque slew, pooled over the axes.

        Raises
        ------
        DesignError
            If the demands are too tight for this vehicle, or the solver's answer does not keep them.
        """
        kept = sensitivity_peak * (1.0 - _GRID_MARGIN)
        for _ in range(_ROUNDS):
            coefficients = _optimize(self.axes, kept, slew * self.bank.dt)
            laws = tuple(_law(m, self.weight, self.bank, q) for m, q in zip(self.models, coefficients, strict=True))
            point = _achieved(self.models, laws)
            excess = point.sensitivity_peak / sensitivity_peak
            if excess <= 1.0 + _TOLERANCE and point.slew <= (1.0 + _TOLERANCE) * slew:
                return point
            if not excess <= 1.0 + _RETRY_EXCESS:
                break
            kept /= excess
        raise DesignError(
            f"no law found at sensitivity peak {sensitivity_peak} and slew {slew} N*m/s: "
            f"the best had {point.sensitivity_peak:.4f} and {point.slew:.4f}"
        )


def linear_laws(models: Sequence[AxisModel], *, functions: int = 36, around: float = 20.0) -> LinearLaws:
    """Return the laws that a constant and a number of orthonormal functions span.

    `around` [N*m/s] is the slew of the optimal law that they are added to. The answers do not depend on it but for the
    functions that are left out: from 2 to 100 N*m/s by less than .1 %.

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

    Takenaka and Malmquist's functions: a low-pass of each pole behind the all-passes of the poles before it.
    """
    n = poles.size
    A, B, at = np.zeros((n, n)), np.zeros((n, 1)), np.append(np.zeros(n), 1.0)  # `at`: chain's signal, of (x, input)
    for i, pole in enumerate(poles):
        size = math.sqrt(1.0 - pole**2)
        A[i], B[i] = size * at[:n] + pole * np.eye(n)[i], size * at[n]
        at = -pole * at
        at[i] += size
    return Lti(A=A, B=B, C=np.eye(n + 1, n, -1), D=np.eye(n + 1, 1), dt=dt)


def _axis(model: AxisModel, weight: float, bank: Lti) -> _Axis:
    error, change = (_moments(model, weight, bank, output) for output in (0, 1))
    omega = np.geomspace(_LOWEST_OMEGA, 0.999 * math.pi / bank.dt, _POINTS)
    return _Axis(error=_root(error), change=_root(change), sensitivity=_sensitivity(model, weight, bank, omega))


def _moments(model: AxisModel, weight: float, bank: Lti, output: int) -> Matrix:
    """Return the second moments (1 + k, 1 + k) of an output over the flight: at `Q` = 0, and of each function.

    `Q` is scalar, so that its functions may as well act on what the surprise does to the output through the plant.
    """
    flight, central = augmented_axis(model), central_controller(model, weight)
    # noises, then what the controller says: command and surprise
    columns = np.hstack([flight.D, np.zeros((3, 1))])[[output, 0, 2]]
    columns[1] = np.eye(1, columns.shape[1], columns.shape[1] - 1)
    P = Lti(
        A=flight.A, B=np.hstack([flight.B, np.zeros((flight.order, 1))]),
        C=np.vstack([flight.C[output], np.zeros(flight.order), flight.C[2]]), D=columns, dt=flight.dt,
    )  # fmt: skip
    whole = lft(P, central.part(slice(0, 2), slice(0, 1)))  # noises to output and surprise
    after = series(_command_response(flight, weight, flight.C[output], flight.D[output, -1]), bank)
    both = Lti(
        A=after.A, B=np.hstack([np.zeros((after.order, 1)), after.B]), C=np.vstack([np.zeros(after.order), after.C]),
        D=np.block([[np.eye(1), np.zeros((1, 1))], [np.zeros((after.n_outputs, 1)), after.D]]), dt=flight.dt,
    )  # fmt: skip
    return mean_second_moments([model], series(whole, both))


def _command_response(flight: Lti, weight: float, C: Matrix, D: float) -> Lti:
    """Return what a further command does to the output `C x + D u` of the axis that the optimal law holds."""
    B, F = flight.B[:, -1:], feedback_gain(flight, weight)
    return Lti(A=flight.A - B @ F, B=B, C=C - D * F, D=np.array([[D]]), dt=flight.dt)


def _sensitivity(model: AxisModel, weight: float, bank: Lti, omega: Matrix) -> ComplexMatrix:
    """Return the sensitivity at the plant's input, (f, 1 + k): at `Q` = 0, and what each function adds."""
    flight = augmented_axis(model)
    gyro = Lti(A=flight.A[1:, 1:], B=flight.B[1:, -1:], C=flight.C[2:, 1:], D=np.zeros((1, 1)), dt=flight.dt)
    G, J = gyro.response(omega)[:, 0, 0], central_controller(model, weight).response(omega)
    S = 1.0 / (1.0 - G * J[:, 0, 0])
    added = S * J[:, 0, 1] * J[:, 1, 0] * G * S
    return np.hstack([S[:, None], added[:, None] * bank.response(omega)[:, :, 0]])


def _optimize(axes: Sequence[_Axis], peak: float, change: float) -> list[Matrix]:
    """Return the coefficients of each axis with the least error at a peak and a pooled change of command."""
    k = axes[0].error.shape[1] - 1
    unknowns = k * len(axes) + 1  # the last one is the error that is made least
    held = math.sqrt(sum(float(np.sum(axis.error[:, 0] ** 2)) for axis in axes))
    blocks = [
        _cone([axis.error / held for axis in axes], np.eye(unknowns)[-1], 0.0),
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
    solution = clarabel.DefaultSolver(
        scipy.sparse.csc_matrix((unknowns, unknowns)), np.eye(unknowns)[-1],
        scipy.sparse.csc_matrix(np.vstack([A for A, _ in blocks])), np.concatenate([b for _, b in blocks]),
        [clarabel.SecondOrderConeT(b.size) for _, b in blocks], settings,
    ).solve()  # fmt: skip
    coefficients = np.array(solution.x[:-1], dtype=np.float64)
    if not np.all(np.isfinite(coefficients)):
        raise DesignError(f"no law found at sensitivity peak {peak:.4g}: the solver says {solution.status}")
    return list(coefficients.reshape(len(axes), k))


def _cone(parts: Sequence[Matrix], slope: Matrix, offset: float) -> tuple[Matrix, Matrix]:
    """Return A and b of the cone |every part times (1, q)| <= slope x + offset, in the solver's form `b - A x`."""
    k = parts[0].shape[1] - 1
    A, b = [-slope[None]], [np.array([offset])]
    for i, part in enumerate(parts):
        rows = np.zeros((part.shape[0], slope.size))
        rows[:, i * k : (i + 1) * k] = -part[:, 1:]
        A.append(rows)
        b.append(part[:, 0])
    return np.vstack(A), np.concatenate(b)


def _root(moments: Matrix) -> Matrix:
    """Return `R` with `R' R` equal to the moments but for rounding."""
    values, vectors = np.linalg.eigh(0.5 * (moments + moments.T))
    kept = values > _ROUNDING * values[-1]
    return np.asarray((vectors[:, kept] * np.sqrt(values[kept])).T)


def _law(model: AxisModel, weight: float, bank: Lti, coefficients: Matrix) -> Lti:
    row = coefficients[None]
    Q = Lti(A=bank.A, B=bank.B, C=row @ bank.C, D=row @ bank.D, dt=bank.dt)
    return lft(central_controller(model, weight), Q)


def _achieved(models: Sequence[AxisModel], laws: tuple[Lti, ...]) -> TradeOff:
    """Return the point that laws have, whatever the solver said."""
    figures = [controller_performance(model, law) for model, law in zip(models, laws, strict=True)]
    rmse, slew = (math.sqrt(float(np.mean([getattr(f, name) ** 2 for f in figures]))) for name in ("rmse", "slew"))
    worst = max(each.sensitivity_peak for each in figures)
    return TradeOff(sensitivity_peak=worst, rmse=rmse, slew=slew, controllers=laws)
