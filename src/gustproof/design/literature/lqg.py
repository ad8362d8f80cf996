"""Linear-quadratic-Gaussian control, that is H2, with the gust's Dryden filter and the gyro's noise.

The regulator has the least mean square of attitude and, weighted, of command and gust together: a gust that the
command cancels costs nothing. It feeds back the strapdown attitude, and rate, torque, delayed commands and gust as a
Kalman filter estimates them. A fictitious noise at the plant's input recovers the regulator's loop transfer.

References
----------
M. Athans, The role and use of the stochastic linear-quadratic-Gaussian problem in control system design, IEEE TAC 16
(1971), 529-552.
J. C. Doyle, G. Stein, Multivariable feedback design: concepts for a classical/modern synthesis, IEEE TAC 26 (1981),
4-16: loop transfer recovery by noise at the plant's input.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from gustproof.airframe.covariance import AxisModel, augmented_axis
from gustproof.design.literature.structure import AxisStructure, newest_attitude
from gustproof.design.loops.filters import SampledAxisLoop
from gustproof.design.loops.settings import LoopSignals
from gustproof.errors import DesignError
from gustproof.law.form import Matrix
from gustproof.robust.lti.state_space import Lti


@dataclass(frozen=True, slots=True, kw_only=True)
class LqgGains:
    """Weights of one axis, all positive."""

    effort: float
    """[s^2] attitude error that weighs as much as 1 rad/s^2 by command and gust together."""
    gust: float
    """[-] moment of the gusts, over its own."""
    recovery: float
    """[rad/s^2] rms of fictitious white noise a sample at the plant's input, as angular acceleration."""


def strapdown_flight(model: AxisModel) -> Lti:
    """Return `augmented_axis` with the law's own attitude, the trapezoidal sum of the gyro, in place of the true one.

    Inputs and outputs are those of `augmented_axis`. The law knows its first state exactly.
    """
    flight = augmented_axis(model)
    A, B = flight.A.copy(), flight.B.copy()
    half = 0.5 * model.plant.dt
    A[0], B[0] = half * (flight.C[2] + flight.C[2] @ A), half * flight.C[2] @ B
    A[0, 0] += 1.0
    return Lti(A=A, B=B, C=flight.C, D=flight.D, dt=flight.dt)


def regulator_gain(gains: LqgGains, model: AxisModel) -> Matrix:
    """Return the gain (1, n) of the command from the states of `strapdown_flight`, its sign reversed."""
    flight = strapdown_flight(model)
    B, R = flight.B[:, -1:], np.array([[(gains.effort / model.inertia) ** 2]])
    gust = np.pad(model.gust.C, ((0, 0), (flight.order - model.gust.order, 0)))
    Q = flight.C[:1].T @ flight.C[:1] + R * gust.T @ gust
    X = _solve(flight.A, B, Q, R, R * gust.T)
    return np.asarray(np.linalg.solve(R + B.T @ X @ B, B.T @ X @ flight.A + R * gust))


def filter_gain(gains: LqgGains, model: AxisModel) -> Matrix:
    """Return the Kalman gain (n - 1, 1) from the gyro's innovation [rad/s] to all states but the attitude."""
    flight = augmented_axis(model)
    A, C, noise = flight.A[1:, 1:], flight.C[2:, 1:], flight.B[1:, :-1].copy()
    entry = np.zeros((len(A), 1))
    entry[: model.plant.order - 1, 0] = gains.recovery * model.inertia * model.plant.B[1:, 0]
    noise[-model.gust.order :] *= gains.gust
    W = noise @ noise.T + entry @ entry.T
    R = np.array([[model.noise**2]])
    P = _solve(A.T, C.T, W, R, np.zeros_like(C.T))
    return np.asarray(P @ C.T / (C @ P @ C.T + R))


def build_lqg(gains: LqgGains, model: AxisModel) -> LoopSignals:
    """Return the loop of one axis; its estimates are those for the new sample before it is read."""
    flight = strapdown_flight(model)
    F, K = regulator_gain(gains, model)[0], filter_gain(gains, model)[:, 0]
    loop = SampledAxisLoop(model.plant.dt)
    before = [loop.state() for _ in K]
    states = np.array(before)
    newest = states + np.outer(K, loop.rate - flight.C[2, 1:] @ states)
    commanded = F[0] / F[1] * (loop.reference - newest_attitude(loop))
    command = F[1] * commanded - F[1:] @ newest
    entry = flight.B[1:, -1]
    for state, signal, excess in zip(
        before, flight.A[1:, 1:] @ newest + np.outer(entry, command), entry.tolist(), strict=True
    ):
        loop.set_next(state, signal, excess)
    return LoopSignals(loop, command, commanded, None)


def _solve(A: Matrix, B: Matrix, Q: Matrix, R: Matrix, S: Matrix) -> Matrix:
    try:
        return np.asarray(scipy.linalg.solve_discrete_are(A, B, Q, R, s=S))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise DesignError(f"no linear-quadratic law: {error}") from None


def _start(speed: float) -> LqgGains:
    return LqgGains(effort=0.01 / speed**2, gust=1.8, recovery=2.4 * speed)


LQG = AxisStructure(
    design="linear-quadratic-Gaussian control with loop transfer recovery (Athans; Doyle, Stein)",
    start=_start,
    bounds=(
        LqgGains(effort=1e-6, gust=0.1, recovery=1e-3),
        LqgGains(effort=1.0, gust=1e2, recovery=1e3),
    ),
    build=build_lqg,
)
"""Law `lqg`."""
