"""The shape of one axis with the least attitude error and weighted torque slew, at a given sensitivity peak.

Error and slew are those of `gustproof.performance.covariance`, their derivatives exact by complex steps; the sensitivity
is kept on a grid of frequencies, for the plant as it is and, at a peak of their own, for plants that are off.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize

from gustproof.law.form import Matrix
from gustproof.lti.state_space import Lti
from gustproof.performance.covariance import AxisModel, augmented_axis, mean_second_moments
from gustproof.synthesis.pid.pid_biquad import BiquadGains, Values, biquad_filter, biquad_response

_GRID = 120
"""Frequencies, evenly spaced in the logarithm, at which the search keeps the sensitivity peak."""
_GRID_MARGIN = 1e-3
"""[-] share of a peak kept back for what the sensitivity may rise between two frequencies of the grid."""
_STEP = 1e-30
"""[-] complex step: no difference is taken, so nothing is lost by a small one."""
_UNSTABLE_COST = 1e3
"""Cost of a loop whose covariance overflows; those of sound loops are below 0."""
_SLOWEST, _FASTEST = 1.0, 1e3
"""[rad/s] between which corners stay: a slower one would leave a held moment in the attitude for seconds."""
_LOWER = BiquadGains(_SLOWEST, 0.1, _SLOWEST, 0.1, _SLOWEST, _SLOWEST, 0.1, _SLOWEST, 0.2)
_UPPER = BiquadGains(50.0, 1e4, _FASTEST, 5.0, _FASTEST, _FASTEST, 5.0, _FASTEST, 5.0)


class SearchResult(NamedTuple):
    """What a search ended at."""

    cost: float
    """Logarithm of mean square error [rad^2] and weighted slew."""
    shape: BiquadGains
    """Where it is least."""


class _Loop(NamedTuple):
    """A closed loop in state space, or several along the first axis."""

    A: Values
    B: Values
    C: Values
    D: Values
    dt: float


class AxisSearch:
    """The search for one axis: plants, peaks and air stay, the price of slew is given with each search.

    Parameters
    ----------
    model
        The axis as it is.
    others
        The axis as it may be: the same for all but the plant.
    peak, peak_of_others
        [-] largest sensitivity peaks.
    """

    def __init__(self, model: AxisModel, others: Sequence[AxisModel], peak: float, peak_of_others: float) -> None:
        self._model = model
        self._flight = _add_strapdown(augmented_axis(model))
        dt = model.plant.dt
        omega = np.geomspace(0.5, 0.999 * math.pi / dt, _GRID)
        z = np.exp(1j * omega * dt)
        self._s = 2.0 / dt * (z - 1.0) / (z + 1.0)
        late = z**-model.delay_samples * model.inertia
        plants = [each.plant.response(omega)[:, 0, 0] * late for each in (model, *others)]
        self._plants = np.array(plants)
        peaks = np.array([peak] + [peak_of_others] * len(others))
        self._room = np.log(peaks * (1.0 - _GRID_MARGIN))[:, None]

    def best(self, starts: Sequence[BiquadGains], weight: float) -> SearchResult | None:
        """Return the best of the optima that a search from each of `starts` ends at; `None` if none is sound.

        Sequential quadratic programming (SLSQP) on the logarithms of the values.

        Parameters
        ----------
        starts
            Shapes, not necessarily sound.
        weight
            [s^2 rad^2/(N*m)^2] price of mean square slew.
        """
        found = [each for each in (self._minimize_from(np.log(np.array(start)), weight) for start in starts) if each]
        return min(found, key=lambda each: each.cost, default=None)

    def margins(self, z: Matrix) -> tuple[Matrix, Matrix]:
        """Return how far, in the logarithm, sensitivities are below their peaks (m,), and the slopes (m, 9)."""
        response, slopes = biquad_response(np.exp(z), self._s)
        L = self._plants * response
        room = np.log(np.abs(1.0 + L)) + self._room
        return room.ravel(), (L / (1.0 + L) * slopes[:, None]).real.reshape(len(z), -1).T

    def cost(self, z: Matrix, weight: float) -> tuple[float, Matrix]:
        """Return the logarithm of mean square error and weighted slew, and its slopes (9,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            moments = mean_second_moments([self._model], self._closed(np.exp(z + 1j * _STEP * np.eye(len(z)))))
        costs = moments[:, 0, 0] + weight / self._model.plant.dt**2 * moments[:, 1, 1]
        value = float(costs[0].real)
        if not (math.isfinite(value) and value > 0.0):
            return _UNSTABLE_COST, np.zeros(len(z))
        return math.log(value), costs.imag / (_STEP * value)

    def _minimize_from(self, start: Matrix, weight: float) -> SearchResult | None:
        def cost(z: Matrix) -> tuple[float, Matrix]:
            return self.cost(z, weight)

        room = scipy.optimize.NonlinearConstraint(
            lambda z: self.margins(z)[0], 0.0, np.inf, jac=lambda z: self.margins(z)[1]
        )
        search = scipy.optimize.minimize(
            cost, start, jac=True, method="SLSQP", bounds=scipy.optimize.Bounds(np.log(_LOWER), np.log(_UPPER)),
            constraints=room, options={"maxiter": 300, "ftol": 1e-10},
        )  # fmt: skip
        if not search.fun < 0.0 or np.min(self.margins(search.x)[0]) < -0.5 * _GRID_MARGIN:
            return None
        return SearchResult(float(search.fun), BiquadGains(*np.exp(search.x).tolist()).ordered())

    def _closed(self, values: Values) -> _Loop:
        """Return the loops of `values` (k, 9), from the noises to attitude and change of command."""
        P, F, n = self._flight, biquad_filter(values, self._model.plant.dt), self._flight.order
        # rate error of (states; noises), and the command that `F` makes of it at once
        ratio = values[:, :1]
        error, noise = -(ratio * P.C[2] + P.C[3]), -(ratio * P.D[2, :-1] + P.D[3, :-1])
        J = self._model.inertia
        through, sent = J * F.D[:, None] * error, J * F.C
        A = np.concatenate([
            np.concatenate([P.A + P.B[:, -1:] * through[:, None], P.B[:, -1:] * sent[:, None]], axis=2),
            np.concatenate([F.B[..., None] * error[:, None], F.A], axis=2),
        ], axis=1)  # fmt: skip
        loud = J * F.D[:, None] * noise
        B = np.concatenate([P.B[:, :-1] + P.B[:, -1:] * loud[:, None], F.B[..., None] * noise[:, None]], axis=1)
        C = P.D[:2, -1:] * np.concatenate([through, sent], axis=1)[:, None]
        C[..., :n] += P.C[:2]
        return _Loop(A, B, C, P.D[:2, :-1] + P.D[:2, -1:] * loud[:, None], P.dt)


def _add_strapdown(flight: Lti) -> Lti:
    """Return the flight of an axis that also tells, before the gyro, the law's own attitude: the trapezoidal sum."""
    n, dt, gyro, fed = flight.order, flight.dt, flight.C[2:], flight.D[2:]
    return Lti(
        A=np.block([[flight.A, np.zeros((n, 1))], [dt * gyro, np.ones((1, 1))]]),
        B=np.vstack([flight.B, dt * fed]),
        C=np.block([
            [flight.C[:2], np.zeros((2, 1))], [0.5 * dt * gyro, np.ones((1, 1))], [gyro, np.zeros((1, 1))],
        ]),
        D=np.vstack([flight.D[:2], 0.5 * dt * fed, fed]),
        dt=dt,
    )  # fmt: skip
