"""Search the gains of one axis for the least attitude error and weighted torque slew at a given sensitivity peak.

Error and slew are those of `gustproof.airframe.covariance`; complex steps give exact derivatives. The sensitivity is
constrained on a grid of frequencies, for the nominal plant and, with a peak each, for plants off nominal.
"""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from gustproof.airframe.covariance import AxisModel, ClosedLoops, augmented_axis, mean_second_moments
from gustproof.design.cascades.pid_biquad import BiquadGains, Values, biquad_filter, biquad_response
from gustproof.law.form import Matrix
from gustproof.robust.lti.state_space import Lti

_GRID = 120
"""Number of frequencies, evenly spaced in the logarithm, at which the sensitivity peak is constrained."""
_GRID_MARGIN = 1e-3
"""[-] share of a peak reserved for a rise of the sensitivity between two frequencies of the grid."""
_STEP = 1e-30
"""[-] complex step: without a difference of values, a small step loses no digits."""
_UNSTABLE_COST = 1e3
"""Cost of a loop with an overflowing covariance; stable loops have costs below 0."""
_ROUGH, _FINE = (60, 1e-6), (300, 1e-10)
"""Most steps of a search, and relative change of its cost that ends it: from each of several starts, and in the end."""
_INTEGRAL = 1e-6
"""[-] by which a computed eigenvalue of two integrals may exceed 1."""
_SLOWEST, _FASTEST = 1.0, 1e3
"""[rad/s] bounds of the corners: with a slower one a constant moment would disturb the attitude for seconds."""
_LOWER = BiquadGains(_SLOWEST, 0.1, _SLOWEST, 0.1, _SLOWEST, _SLOWEST, 0.1, _SLOWEST, 0.2)
_UPPER = BiquadGains(50.0, 1e4, _FASTEST, 5.0, _FASTEST, _FASTEST, 5.0, _FASTEST, 5.0)


class SearchResult(NamedTuple):
    """Optimum found by a search."""

    cost: float
    """Logarithm of the sum of mean square error [rad^2] and weighted slew."""
    gains: BiquadGains
    """Gains at the optimum."""


class AxisSearch:
    """Search for one axis with fixed plants, peaks and air; each call takes its own weight of slew.

    `peak` is the largest sensitivity peak [-] of `model`. `others` are the axis off nominal, in plant or delay only,
    each with its own largest peak. Those from `guarded` on are far from nominal: beyond a limit their sensitivity may
    be small again, in an unstable loop, so their stability is watched.
    """

    def __init__(
        self, model: AxisModel, peak: float, others: Sequence[tuple[AxisModel, float]], guarded: int | None = None
    ) -> None:
        self._model = model
        self._flight = _add_strapdown(augmented_axis(model))
        far = [] if guarded is None else others[guarded:]
        self._far = [_add_strapdown(augmented_axis(each)) for each, _ in far]
        dt = model.plant.dt
        omega = np.geomspace(0.5, 0.999 * math.pi / dt, _GRID)
        z = np.exp(1j * omega * dt)
        self._s = 2.0 / dt * (z - 1.0) / (z + 1.0)
        plants, peaks = zip((model, peak), *others, strict=True)
        self._plants = np.array(
            [each.plant.response(omega)[:, 0, 0] * (z**-each.delay_samples * model.inertia) for each in plants]
        )
        self._log_peaks = np.log(np.array(peaks) * (1.0 - _GRID_MARGIN))[:, None]

    def search(self, starts: Sequence[BiquadGains], weight: float) -> SearchResult | None:
        """Return the best local optimum over all `starts`; `None` if none is stable and within the peaks.

        Sequential quadratic programming (SLSQP) on the logarithms of the values; starts need not be stable. `weight`
        [s^2 rad^2/(N*m)^2] is that of mean square slew.
        """
        with np.errstate(all="ignore"):  # a search passes unstable loops
            if len(starts) > 1:
                rough = [self._minimize_from(start, weight, _ROUGH) for start in starts]
                starts = [each.gains for each in sorted(filter(None, rough), key=lambda each: each.cost)] or starts
            return next((each for start in starts if (each := self._minimize_from(start, weight, _FINE))), None)

    def margins(self, z: Matrix) -> tuple[Matrix, Matrix]:
        """Return the logarithms (m,) of peak over sensitivity, at least 0 if within, and their slopes (m, 9)."""
        response, slopes = biquad_response(np.exp(z), self._s)
        L = self._plants * response
        room = np.log(np.abs(1.0 + L)) + self._log_peaks
        return room.ravel(), (L / (1.0 + L) * slopes[:, None]).real.reshape(len(z), -1).T

    def cost(self, z: Matrix, weight: float, *, watched: bool = True) -> tuple[float, Matrix]:
        """Return the logarithm of mean square error and weighted slew, and its slopes (9,).

        It is that of an unstable loop too if one far from nominal is unstable and `watched`.
        """
        loops = self._closed_loops(self._flight, np.exp(z + 1j * _STEP * np.eye(len(z))))
        with np.errstate(over="ignore", invalid="ignore"):
            moments = mean_second_moments([self._model], loops)
        costs = moments[:, 0, 0] + weight / self._model.plant.dt**2 * moments[:, 1, 1]
        value = float(costs[0].real)
        if not (math.isfinite(value) and value > 0.0) or (watched and not self._is_stable_afar(z)):
            return _UNSTABLE_COST, np.zeros(len(z))
        return math.log(value), costs.imag / (_STEP * value)

    def _minimize_from(
        self, start: BiquadGains, weight: float, effort: tuple[int, float], *, watched: bool = False
    ) -> SearchResult | None:
        """Return the optimum from a start. Loops far from nominal are watched only if it is unstable there else."""
        constraint = scipy.optimize.NonlinearConstraint(
            lambda z: self.margins(z)[0], 0.0, np.inf, jac=lambda z: self.margins(z)[1]
        )
        found = scipy.optimize.minimize(
            functools.partial(self.cost, watched=watched),
            np.log(np.array(start)),
            args=(weight,),
            jac=True,
            method="SLSQP",
            bounds=scipy.optimize.Bounds(np.log(_LOWER), np.log(_UPPER)),
            constraints=constraint,
            options={"maxiter": effort[0], "ftol": effort[1]},
        )
        if not found.fun < 0.0 or np.min(self.margins(found.x)[0]) < -0.5 * _GRID_MARGIN:
            return None
        if not watched and not self._is_stable_afar(found.x):
            return self._minimize_from(start, weight, effort, watched=True)
        return SearchResult(float(found.fun), BiquadGains(*np.exp(found.x).tolist()).sort_zeros())

    def _is_stable_afar(self, z: Matrix) -> bool:
        """Return whether the loops of all far models are stable."""
        return all(self._is_stable(far, z) for far in self._far)

    def _is_stable(self, flight: Lti, z: Matrix) -> bool:
        """Return whether the loop of a far model is stable but for the two attitudes, which are integrals."""
        (A,) = self._closed_loops(flight, np.exp(z)[None]).A
        return bool(np.isfinite(A).all() and np.abs(np.linalg.eigvals(A)).max() < 1.0 + _INTEGRAL)

    def _closed_loops(self, P: Lti, values: Values) -> ClosedLoops:
        """Return the loops of `values` (k, 9) around a flight, from the noises to attitude and change of command."""
        F, n = biquad_filter(values, self._model.plant.dt), P.order
        # rate error by (states; noises), and the direct command of `F`
        ratio = values[:, :1]
        error, noise = -(ratio * P.C[2] + P.C[3]), -(ratio * P.D[2, :-1] + P.D[3, :-1])
        J = self._model.inertia
        direct, filtered = J * F.D[:, None] * error, J * F.C
        upper = np.concatenate([P.A + P.B[:, -1:] * direct[:, None], P.B[:, -1:] * filtered[:, None]], axis=2)
        lower = np.concatenate([F.B[..., None] * error[:, None], F.A], axis=2)
        A = np.concatenate([upper, lower], axis=1)
        noisy = J * F.D[:, None] * noise
        B = np.concatenate([P.B[:, :-1] + P.B[:, -1:] * noisy[:, None], F.B[..., None] * noise[:, None]], axis=1)
        C = P.D[:2, -1:] * np.concatenate([direct, filtered], axis=1)[:, None]
        C[..., :n] += P.C[:2]
        return ClosedLoops(A, B, C, P.D[:2, :-1] + P.D[:2, -1:] * noisy[:, None], P.dt)


def _add_strapdown(flight: Lti) -> Lti:
    """Return the axis with one more output before the gyro: the law's own attitude, by the trapezoidal sum."""
    n, dt, gyro, feedthrough = flight.order, flight.dt, flight.C[2:], flight.D[2:]
    zero, one = np.zeros((1, 1)), np.ones((1, 1))
    A = np.block([[flight.A, np.zeros((n, 1))], [dt * gyro, one]])
    C = np.block([[flight.C[:2], np.zeros((2, 1))], [0.5 * dt * gyro, one], [gyro, zero]])
    D = np.vstack([flight.D[:2], 0.5 * dt * feedthrough, feedthrough])
    return Lti(A=A, B=np.vstack([flight.B, dt * feedthrough]), C=C, D=D, dt=dt)
