"""Predict a complete law in turbulence, without a flight, on the model of `gustproof.airframe.covariance`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.types import Vector
from gustproof.airframe.covariance import AxisModel, augmented_axis, axis_models, mean_second_moments
from gustproof.airframe.hover import loop_law
from gustproof.law.form import Law, Matrix, Output
from gustproof.robust.lti.state_space import Lti, lft


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """Predicted performance of three axes at once."""

    rmse: float
    """[rad] root mean square of the Euler angles over the scenario, of all flights."""
    slew: float
    """[N*m/s] root mean square of the commands' change from sample to sample, divided by the sample time."""
    axes_rmse: Vector
    """[rad] `rmse` of phi, theta and psi."""
    axes_slew: Vector
    """[N*m/s] `slew` about each axis."""
    own_rate: float | None
    """[rad/s] root mean square rate where the gyro's noise keeps its ratio to this rate; `None` at no such noise."""
    own_rate_rmse: float | None
    """[rad] `rmse` with that noise, in place of the one that the vehicle's `reference_rate` sets."""
    seen_rmse: float | None
    """[rad] `rmse` of the attitude that the law sees: without its gyro's drift, which an autopilot's estimator removes.

    `None` for a law without an estimate of attitude."""


def predict(law: Law, vehicle: Vehicle, scenario: Scenario) -> Prediction | None:
    """Return error and slew of a torque law in the scenario's turbulence, vehicle held; `None` for a law of rates.

    The result is exact for small angles and a law within its limits, linear at level attitude. The loop must be stable,
    except for the attitude itself.

    Raises
    ------
    ValueError
        If the scenario has no Dryden turbulence.

    Examples
    --------
    >>> import math
    >>> from gustproof import load_law, load_scenario, load_vehicle, predict
    >>> found = predict(load_law("pid-fair"), load_vehicle("paper"), load_scenario("paper-turbulence"))
    >>> f"{math.degrees(found.rmse):.2f} deg, {found.slew:.0f} N m/s"
    '0.11 deg, 20 N m/s'
    """
    if law.output is not Output.TORQUE:
        return None
    models = axis_models(vehicle, scenario)
    whole = _mean_squares(models, law, vehicle, scenario)
    quiet = _mean_squares([replace(model, noise=0.0) for model in models], law, vehicle, scenario)
    # Mean squares are linear in the noise's variance s, in units of the one set by the reference rate r. Its ratio to
    # the rate stays for s r^2 = quiet + s (whole - quiet).
    axes_rmse, axes_slew = np.sqrt(whole[0]), np.sqrt(whole[1]) / scenario.dt
    whole, quiet = np.mean([whole, quiet], axis=2)
    by_noise, reference_square = whole - quiet, vehicle.gyro.reference_rate**2
    own_rate = own_rate_rmse = None
    if by_noise[2] < reference_square:
        variance = quiet[2] / (reference_square - by_noise[2])
        own_rate, own_rate_rmse = math.sqrt(variance * reference_square), math.sqrt(quiet[0] + variance * by_noise[0])
    return Prediction(
        rmse=math.sqrt(whole[0]),
        slew=math.sqrt(whole[1]) / scenario.dt,
        axes_rmse=(float(axes_rmse[0]), float(axes_rmse[1]), float(axes_rmse[2])),
        axes_slew=(axes_slew[0], axes_slew[1], axes_slew[2]),
        own_rate=own_rate,
        own_rate_rmse=own_rate_rmse,
        seen_rmse=math.sqrt(whole[3]) if law.is_scheduled else None,
    )


def _mean_squares(models: Sequence[AxisModel], law: Law, vehicle: Vehicle, scenario: Scenario) -> Matrix:
    """Return mean squares (4, 3) of attitude [rad^2], command change [(N*m)^2], rate [(rad/s)^2] and first states.

    The law's first three states are its attitude [rad], if it estimates one.
    """
    closed = close_vehicle(models, law, vehicle, scenario)
    first = np.eye(3, closed.order, closed.order - law.order)
    seen = Lti(
        A=closed.A, B=closed.B, C=np.vstack([closed.C, first]), D=np.pad(closed.D, ((0, 3), (0, 0))), dt=closed.dt
    )
    return np.diag(mean_second_moments(models, seen)).reshape(4, 3)


def close_vehicle(models: Sequence[AxisModel], law: Law, vehicle: Vehicle, scenario: Scenario) -> Lti:
    """Return three axes closed by a torque law: noises in; attitudes, command changes and rates out."""
    return lft(_augmented_vehicle(models, vehicle, scenario), _controller(law))


def _augmented_vehicle(models: Sequence[AxisModel], vehicle: Vehicle, scenario: Scenario) -> Lti:
    """Return three axes as one: noises and commands in; attitudes, command changes, rates, gyro, roll and pitch out.

    The last two are those of the accelerometer, with its noise. At level attitude roll is -f_y / g, pitch f_x / g.
    """
    axes = [augmented_axis(model) for model in models]
    A, B, C, D = (scipy.linalg.block_diag(*(getattr(axis, name) for axis in axes)) for name in "ABCD")
    last = np.cumsum([axis.n_inputs for axis in axes]) - 1
    noises = [i for i in range(B.shape[1]) if i not in last]
    attitudes, changes, gyros = ([3 * axis + output for axis in range(3)] for output in range(3))
    density = vehicle.accelerometer.noise_density if scenario.accelerometer.noise else 0.0
    noise = density / GRAVITY * math.sqrt(0.5 * scenario.control_rate_hz) * np.eye(2)
    outputs, order = [*attitudes, *changes, *gyros, *gyros], [*noises, *last]
    B, D = B[:, order], D[np.ix_(outputs, order)]
    D[6:9] = 0.0  # a rate is what the gyro reads without its noise
    D = np.block([[np.zeros((12, 2)), D], [noise, np.zeros((2, B.shape[1]))]])
    B, C = np.hstack([np.zeros((A.shape[0], 2)), B]), C[[*outputs, *attitudes[:2]]]
    return Lti(A=A, B=B, C=C, D=D, dt=scenario.dt)


def _controller(law: Law) -> Lti:
    """Return the linear law from gyro, roll and pitch (5,) to the command (3,); columns it does not use are 0."""
    K = loop_law(law)
    unused = 5 - K.n_inputs
    B, D = (np.pad(matrix, ((0, 0), (0, unused))) for matrix in (K.B, K.D))
    return Lti(A=K.A, B=B, C=K.C, D=D, dt=law.dt)
