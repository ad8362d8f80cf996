"""What no law can beat in turbulence: least attitude error, pooled over the axes, at a given torque slew.

Two bounds, on the model of `gustproof.performance.covariance` and on the figure that is flown: the mean over the flight,
from rest, during which the attitude of every gyro-only law walks at random by the gyro's noise.

- `output_feedback_limit`: the law knows the gyro's samples and the true spectra. Linear-quadratic-Gaussian control: plant and
  spectra are linear and Gaussian, so no law is better, linear or not, whatever its margins.
- `full_information_limit`: the law knows attitude, rate, torque and the state of the air exactly, but not the white noise
  that drives the air from now on. No sensor tells more; what is left is what delay, lag and slew cost.

Both are of stationary gains; those that vary with time since rest would have less error by some .05 % in 60 s.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from gustproof.errors import DesignError
from gustproof.law.form import Matrix
from gustproof.lti.state_space import Lti, gain, lft
from gustproof.performance.covariance import AxisModel, augmented_axis, mean_second_moments

_WEIGHTS = (-16.0, 2.0)
"""Decimal logarithms of the weights of slew that are looked among; at the least of them slew is as good as free."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """Least error at a slew."""

    rmse: float
    """[rad] root mean square attitude over the flight, of all axes."""
    slew: float
    """[N*m/s] rms torque slew, of all axes."""
    weight: float
    """[rad^2/(N*m)^2] price of slew at which it is least: of the square of a change from sample to sample."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimator:
    """The gains of a law that minimises error and weighted slew: `u = -F x` of the state `x` of `augmented_axis`."""

    F: Matrix
    """(1, n) state to command."""
    K: Matrix
    """(n, 1) newest gyro sample's surprise [rad/s] to estimate."""


def output_feedback_limit(models: Sequence[AxisModel], slew: float) -> Limit:
    """Return the least error that any law has that measures with gyros alone, at most at rms torque `slew` [N*m/s].

    Raises
    ------
    DesignError
        If the slew is too little to hold attitude.

    Examples
    --------
    >>> import math
    >>> from gustproof import axis_models, load_scenario, load_vehicle, output_feedback_limit
    >>> models = axis_models(load_vehicle("paper"), load_scenario("paper-turbulence"))
    >>> f"{math.degrees(output_feedback_limit(models, slew=20.0).rmse):.3f} deg"
    '0.071 deg'
    """

    def flown(model: AxisModel, weight: float) -> Matrix:
        central = central_controller(model, weight).part(slice(0, 1), slice(0, 1))
        return mean_second_moments([model], lft(augmented_axis(model), central))

    return _limit_at_slew(models, slew, flown)


def full_information_limit(models: Sequence[AxisModel], slew: float) -> Limit:
    """Return the least error that any law has that knows state and air exactly, at most at rms torque `slew` [N*m/s].

    With `slew` infinite, nothing but the delay and the actuator's lag stands between the law and the moment.

    Raises
    ------
    DesignError
        See `output_feedback_limit`.

    Examples
    --------
    >>> from gustproof import axis_models, full_information_limit, load_scenario, load_vehicle, output_feedback_limit
    >>> models = axis_models(load_vehicle("paper"), load_scenario("paper-turbulence"))
    >>> full_information_limit(models, slew=20.0).rmse < output_feedback_limit(models, slew=20.0).rmse
    True
    """

    def flown(model: AxisModel, weight: float) -> Matrix:
        flight = augmented_axis(model)
        seen = Lti(
            A=flight.A, B=flight.B, C=np.vstack([flight.C[:2], np.eye(flight.order)]),
            D=np.vstack([flight.D[:2], np.zeros((flight.order, flight.n_inputs))]), dt=flight.dt,
        )  # fmt: skip
        return mean_second_moments([model], lft(seen, gain(-feedback_gain(flight, weight), flight.dt)))

    return _limit_at_slew(models, slew, flown)


def central_controller(model: AxisModel, weight: float) -> Lti:
    """Return the law of least mean squares of error and `weight` times change of command, open for more.

    Inputs are the gyro [rad/s] and a further command [N*m], outputs the whole command and the gyro's surprise, which is
    white and does not answer to the further command: closed by any stable `Q` from its second output to its second
    input, it is every law that stabilises the axis. `Q = 0` is the optimal one.
    """
    flight = augmented_axis(model)
    A, B, C = flight.A, flight.B[:, -1:], flight.C[2:]
    F, K = feedback_gain(flight, weight), kalman_gain(flight)
    newest, moved = np.eye(flight.order) - K @ C, A - B @ F
    return Lti(
        A=moved @ newest, B=np.hstack([moved @ K, B]), C=np.vstack([-F @ newest, -C]),
        D=np.vstack([np.hstack([-F @ K, [[1.0]]]), [1.0, 0.0]]), dt=flight.dt,
    )  # fmt: skip


def feedback_gain(flight: Lti, weight: float) -> Matrix:
    """Return `F` (1, n) of the command `-F x` with the least mean square of attitude and weighted change of command."""
    A, B, last = flight.A, flight.B[:, -1:], -flight.C[1:2]
    price = np.array([[weight]])
    X = scipy.linalg.solve_discrete_are(
        A, B, flight.C[:1].T @ flight.C[:1] + weight * last.T @ last, price, s=-weight * last.T
    )
    return np.asarray(np.linalg.solve(price + B.T @ X @ B, B.T @ X @ A - weight * last))


def kalman_gain(flight: Lti) -> Matrix:
    """Return the Kalman gain `K` (n, 1) from the gyro's surprise to the state of `augmented_axis`.

    The covariance of the attitude's error grows for ever, as no gyro sees attitude, but its correlation with the errors
    of the other states, which are estimated first, settles: that is what its gain needs.
    """
    A, C, noise = flight.A, flight.C[2:], flight.B[:, :-1]
    W, R = noise @ noise.T, flight.D[2:, :-1] @ flight.D[2:, :-1].T
    seen = slice(1, None)
    P = scipy.linalg.solve_discrete_are(A[seen, seen].T, C[:, seen].T, W[seen, seen], R)
    surprise = C[:, seen] @ P @ C[:, seen].T + R
    K = P @ C[:, seen].T / surprise
    errors = A[seen, seen] @ (np.eye(P.shape[0]) - K @ C[:, seen])
    correlation = np.linalg.solve(np.eye(P.shape[0]) - errors, errors @ P @ A[0, seen] + W[seen, 0])
    return np.vstack([C[:, seen] @ correlation / surprise, K])


def pooled_rms(moments: Sequence[Matrix], dt: float) -> tuple[float, float]:
    """Return rms attitude [rad] and slew [N*m/s] of all axes from their `mean_second_moments`."""
    rmse, change = (math.sqrt(float(np.mean([each[k, k] for each in moments]))) for k in (0, 1))
    return rmse, change / dt


def _limit_at_slew(models: Sequence[AxisModel], slew: float, flown: Callable[[AxisModel, float], Matrix]) -> Limit:
    """Return the optimum that keeps the slew: one weight for all axes shares it best among them."""

    def at(exponent: float) -> tuple[float, float]:
        return pooled_rms([flown(model, 10.0**exponent) for model in models], models[0].plant.dt)

    def excess(exponent: float) -> float:
        return math.log(at(exponent)[1]) - math.log(slew)

    least, most = _WEIGHTS
    if excess(most) > 0.0:
        raise DesignError(f"no law holds attitude in this turbulence at slew {slew} N*m/s")
    exponent = least if excess(least) < 0.0 else float(scipy.optimize.brentq(excess, least, most, xtol=1e-6))
    rmse, spent = at(exponent)
    return Limit(rmse=rmse, slew=spent, weight=10.0**exponent)
