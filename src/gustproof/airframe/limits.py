"""Lower bounds on the attitude error of all laws in turbulence, pooled over the axes, at a given torque slew.

Two bounds, on the model of `gustproof.airframe.covariance`. Both are means over a flight from rest, as in the
metrics of flights. During a flight the gyro's noise makes the attitude of every gyro-only law walk at random.

- `output_feedback_limit`: the law knows the gyro's samples and the true spectra. This is linear-quadratic-Gaussian
  control: plant and spectra are linear and Gaussian, so no law is better, linear or not, at any margins.
- `full_information_limit`: the law knows attitude, rate, torque and the state of the air exactly, but not the future
  white noise that drives the air. No sensor gives more; the remaining error is due to delay, lag and slew.

Both use stationary gains; gains that vary with time since rest would reduce the error by some .05 % in 60 s.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from gustproof.airframe.covariance import AxisModel, augmented_axis, mean_second_moments
from gustproof.errors import DesignError
from gustproof.law.form import Matrix
from gustproof.robust.lti.state_space import Lti, gain, lft

_WEIGHTS = (-16.0, 2.0)
"""Decimal logarithms of the least and the largest weight of slew at an inertia of about .2 kg*m^2.

At the least, slew is practically free.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastError:
    """Least error at a slew."""

    rmse: float
    """[rad] root mean square attitude over the flight, of all axes."""
    slew: float
    """[N*m/s] rms torque slew, of all axes."""
    weight: float
    """[rad^2/(N*m)^2] weight of the squared change of command from sample to sample at this optimum."""


def output_feedback_limit(models: Sequence[AxisModel], slew: float) -> LeastError:
    """Return the least error of all gyro-only laws with an rms torque slew of at most `slew` [N*m/s].

    Raises
    ------
    DesignError
        If the slew is too small to hold attitude.

    Examples
    --------
    >>> import math
    >>> from gustproof import axis_models, load_scenario, load_vehicle, output_feedback_limit
    >>> models = axis_models(load_vehicle("paper"), load_scenario("paper-turbulence"))
    >>> f"{math.degrees(output_feedback_limit(models, slew=20.0).rmse):.3f} deg"
    '0.071 deg'
    """

    def output_moments(model: AxisModel, weight: float) -> Matrix:
        central = central_controller(model, weight).subsystem(slice(0, 1), slice(0, 1))
        return mean_second_moments([model], lft(augmented_axis(model), central))

    return _limit_at_slew(models, slew, output_moments)


def full_information_limit(models: Sequence[AxisModel], slew: float) -> LeastError:
    """Return the least error of all laws that know state and air, with an rms torque slew of at most `slew` [N*m/s].

    With `slew` infinite, only the delay and the actuator's lag remain between the law and the moment. It raises what
    `output_feedback_limit` raises.

    Examples
    --------
    >>> from gustproof import axis_models, full_information_limit, load_scenario, load_vehicle, output_feedback_limit
    >>> models = axis_models(load_vehicle("paper"), load_scenario("paper-turbulence"))
    >>> full_information_limit(models, slew=20.0).rmse < output_feedback_limit(models, slew=20.0).rmse
    True
    """

    def output_moments(model: AxisModel, weight: float) -> Matrix:
        flight = augmented_axis(model)
        C = np.vstack([flight.C[:2], np.eye(flight.order)])
        D = np.vstack([flight.D[:2], np.zeros((flight.order, flight.n_inputs))])
        full_state = Lti(A=flight.A, B=flight.B, C=C, D=D, dt=flight.dt)
        return mean_second_moments([model], lft(full_state, gain(-feedback_gain(flight, weight), flight.dt)))

    return _limit_at_slew(models, slew, output_moments)


def central_controller(model: AxisModel, weight: float) -> Lti:
    """Return the optimal law, extended by one input and one output to all stabilising laws of the axis.

    The optimum has the least sum of mean-square error and `weight` times mean-square change of command. Inputs are the
    gyro [rad/s] and an additional command [N*m]. Outputs are the total command and the gyro's innovation, which is
    white and does not depend on the additional command.

    Closing the second output to the second input by all stable `Q` gives every law that stabilises the axis; `Q = 0` is
    the optimal one.
    """
    flight = augmented_axis(model)
    A, B, C = flight.A, flight.B[:, -1:], flight.C[2:]
    F, K = feedback_gain(flight, weight), kalman_gain(flight)
    update, closed = np.eye(flight.order) - K @ C, A - B @ F
    D = np.vstack([np.hstack([-F @ K, [[1.0]]]), [1.0, 0.0]])
    return Lti(A=closed @ update, B=np.hstack([closed @ K, B]), C=np.vstack([-F @ update, -C]), D=D, dt=flight.dt)


def feedback_gain(flight: Lti, weight: float) -> Matrix:
    """Return `F` (1, n) of the command `-F x` with the least mean square of attitude and weighted change of command."""
    A, B, last = flight.A, flight.B[:, -1:], -flight.C[1:2]
    control_weight = np.array([[weight]])
    X = scipy.linalg.solve_discrete_are(
        A, B, flight.C[:1].T @ flight.C[:1] + weight * last.T @ last, control_weight, s=-weight * last.T
    )
    return np.asarray(np.linalg.solve(control_weight + B.T @ X @ B, B.T @ X @ A - weight * last))


def kalman_gain(flight: Lti) -> Matrix:
    """Return the Kalman gain `K` (n, 1) from the gyro's innovation [rad/s] to the state of `augmented_axis`.

    No gyro measures attitude, so the covariance of its error grows without bound. Its correlation with the errors of
    the other states converges, and its gain needs this correlation only; so the other states are estimated first.
    """
    A, C, noise = flight.A, flight.C[2:], flight.B[:, :-1]
    W, R = noise @ noise.T, flight.D[2:, :-1] @ flight.D[2:, :-1].T
    rest = slice(1, None)  # all states but the attitude
    P = scipy.linalg.solve_discrete_are(A[rest, rest].T, C[:, rest].T, W[rest, rest], R)
    innovation = C[:, rest] @ P @ C[:, rest].T + R
    K = P @ C[:, rest].T / innovation
    errors = A[rest, rest] @ (np.eye(P.shape[0]) - K @ C[:, rest])
    correlation = np.linalg.solve(np.eye(P.shape[0]) - errors, errors @ P @ A[0, rest] + W[rest, 0])
    return np.vstack([C[:, rest] @ correlation / innovation, K])


def pooled_rms(moments: Sequence[Matrix], dt: float) -> tuple[float, float]:
    """Return rms attitude [rad] and slew [N*m/s] of all axes from their `mean_second_moments`."""
    rmse, change = (math.sqrt(float(np.mean([each[k, k] for each in moments]))) for k in (0, 1))
    return rmse, change / dt


def _limit_at_slew(
    models: Sequence[AxisModel], slew: float, output_moments: Callable[[AxisModel, float], Matrix]
) -> LeastError:
    """Return the optimum within the slew; one weight for all axes distributes the slew optimally among them."""

    def rms_at(exponent: float) -> tuple[float, float]:
        return pooled_rms([output_moments(model, 10.0**exponent) for model in models], models[0].plant.dt)

    def excess(exponent: float) -> float:
        return math.log(rms_at(exponent)[1]) - math.log(slew)

    # a torque weighs as the angular acceleration that it gives: light vehicles have small torques
    decades = -2 * round(math.log10(5.0 * float(np.mean([model.inertia for model in models]))))
    least, most = (exponent + decades for exponent in _WEIGHTS)
    if excess(most) > 0.0:
        raise DesignError(f"no law holds attitude in this turbulence at slew {slew} N*m/s")
    exponent = least if excess(least) < 0.0 else float(scipy.optimize.brentq(excess, least, most, xtol=1e-6))
    rmse, achieved = rms_at(exponent)
    return LeastError(rmse=rmse, slew=achieved, weight=10.0**exponent)
