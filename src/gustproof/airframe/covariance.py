"""Predict attitude error, torque slew and sensitivity peak of a linear law in turbulence, without a flight.

The model is exact for small angles, from rest, over the scenario's duration. It contains plant, actuator and delayed
commands at the sample rate, the flight's own filters of turbulence, its gust map, and white gyro noise. Angular gusts
act through the rate damping alone. They are in the model where that is the rotors' drag, and omitted where the vehicle
file gives a number, as `paper` does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import RandomGusts, VonKarman
from firmware_model.physics.dryden import dryden_filters, dryden_spectrum, gust_moment
from firmware_model.physics.von_karman import karman_filters
from gustproof.law.cascade import AxisLaw
from gustproof.law.form import Matrix
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, delay, discretize_zoh, lft, sensitivity, series


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisPerformance:
    """Predicted performance of one axis under its law."""

    rmse: float
    """[rad] root mean square attitude over the scenario, of all flights."""
    slew: float
    """[N*m/s] root mean square of the command's change from sample to sample, divided by the sample time."""
    sensitivity_peak: float
    """[-] largest magnitude of 1 / (1 + L) over frequency, the loop broken at the plant's input."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisModel:
    """One axis for small angles: states attitude [rad], rate [rad/s], torque [N*m]."""

    plant: Lti
    """Torque held over a sample [N*m] to the rate [rad/s]; discrete."""
    disturbance: Matrix
    """(3,) moment held over a sample [N*m] to next state."""
    gust: Lti
    """White noise of variance 1 a sample to the disturbance moment [N*m]."""
    gust_covariance: Matrix
    """(m, m) stationary covariance of the gust's states."""
    noise: float
    """[rad/s] rms of a gyro sample's noise."""
    delay_samples: int
    """Samples from a measurement to the action of its command."""
    inertia: float
    """[kg*m^2] moment of inertia."""
    samples: int
    """Samples in the flight."""


class ClosedLoops(NamedTuple):
    """A closed loop in state space, or several along the first axis."""

    A: Matrix
    """(n, n) or (k, n, n) state to next state."""
    B: Matrix
    """(n, w) or (k, n, w) noises to next state."""
    C: Matrix
    """(p, n) or (k, p, n) state to output."""
    D: Matrix
    """(p, w) or (k, p, w) noises to output."""
    dt: float
    """[s] sample time."""


def axis_models(vehicle: Vehicle, scenario: Scenario) -> tuple[AxisModel, AxisModel, AxisModel]:
    """Return the models of roll, pitch and yaw in the scenario's turbulence.

    Raises
    ------
    ValueError
        If the scenario has no turbulence, no wind of kind 'dryden' or 'von_karman'.

    Examples
    --------
    >>> from gustproof import axis_models, load_scenario, load_vehicle
    >>> roll, pitch, yaw = axis_models(load_vehicle("paper"), load_scenario("paper-turbulence"))
    >>> roll.plant.order
    3
    """
    turbulence = next((item for item in scenario.wind if isinstance(item, RandomGusts)), None)
    if turbulence is None:
        raise ValueError(f"scenario '{scenario.name}' has no turbulence, no wind of kind 'dryden' or 'von_karman'")
    filters, angular = _gust_filters(turbulence, vehicle.span, scenario)
    gain = scenario.gust_scale * vehicle.gust_gain
    map_B = np.array([gust_moment(gain, vehicle.gust_yaw_ratio, tuple(e)) for e in np.eye(3)]).T
    models = []
    for axis in range(3):
        component = int(np.argmax(np.abs(map_B[axis])))
        A, B, C, stationary = filters[component]
        moment = Lti(A=A, B=B, C=map_B[axis, component] * C, D=np.zeros((1, B.shape[1])), dt=scenario.dt)
        if vehicle.rate_damping is None:
            # It shares no noise with the gust beside it: p is beside v, q of w beside u, r of v beside w.
            A, B, C, own = angular[axis]
            drag = vehicle.inertia_B[axis] * vehicle.rate_damping_B[axis]
            moment = Lti(
                A=scipy.linalg.block_diag(moment.A, A),
                B=scipy.linalg.block_diag(moment.B, B),
                C=np.hstack([moment.C, drag * C]),
                D=np.zeros((1, moment.n_inputs + B.shape[1])),
                dt=scenario.dt,
            )
            stationary = scipy.linalg.block_diag(stationary, own)
        models.append(_axis_model(vehicle, scenario, axis, moment, stationary))
    return models[0], models[1], models[2]


_Filter = tuple[Matrix, Matrix, Matrix, Matrix]  # A, B, C of white noise of variance 1, stationary covariance


def _gust_filters(air: RandomGusts, span: float, scenario: Scenario) -> tuple[list[_Filter], list[_Filter]]:
    """Return the filters of u, v, w [m/s], and of p, q, r [rad/s]."""
    spectrum = dryden_spectrum(air, scenario.altitude_m, span)
    if isinstance(air, VonKarman):
        f, factor = karman_filters(spectrum, span, scenario.dt)
        P = factor @ factor.T
        (v, r), (w, q) = (
            [(np.diag(t.a), np.array([t.b, t.d]).T, np.array([row]), P[at, at]) for row in (t.c, t.e)]
            for t, at in ((f.v, slice(5, 11)), (f.w, slice(11, 17)))
        )
        u = (np.diag(f.u.a), np.array([f.u.b]).T, np.array([f.u.c]), P[:5, :5])
        return [u, v, w], [(np.array([[f.p_a]]), np.array([[f.p_b]]), np.eye(1), P[17:, 17:]), q, r]
    d, factor = dryden_filters(spectrum, span, scenario.dt)
    P, sides = factor @ factor.T, []
    for t, at in ((d.v, 1), (d.w, 4)):
        A = np.array([[t.a11, 0.0, 0.0], [t.a21, t.a22, 0.0], [t.a31, t.a32, t.a33]])
        B = np.array([[t.b11, 0.0, 0.0], [t.b21, t.b22, 0.0], [t.b31, t.b32, t.b33]])
        C, own = np.array([[t.c1, t.c2, -1.0]]), P[at : at + 3, at : at + 3]
        sides.append(((A[:2, :2].copy(), B[:2, :2].copy(), C[:, :2], own[:2, :2]), (A, B, t.slope * C, own)))
    (v, r), (w, q) = sides
    u = (np.array([[d.u_a]]), np.array([[d.u_b]]), np.array([[1.0]]), P[:1, :1])
    return [u, v, w], [(np.array([[d.p_a]]), np.array([[d.p_b]]), np.eye(1), P[7:, 7:]), q, r]


def augmented_axis(model: AxisModel) -> Lti:
    """Return one axis with its turbulence: noises and command in; attitude, change of command and gyro out.

    Inputs are the white noises of air and gyro, of variance 1 a sample, then the command [N*m]. Outputs are attitude
    [rad], command minus the previous one [N*m], and gyro [rad/s]. States are body, delayed commands (at least the last
    one), air.
    """
    n, chain, m, w = model.plant.order, max(model.delay_samples, 1), model.gust.order, model.gust.n_inputs
    body, sent, air = slice(0, n), slice(n, n + chain), slice(n + chain, n + chain + m)
    A, B = np.zeros((air.stop, air.stop)), np.zeros((air.stop, w + 2))
    C, D = np.zeros((3, air.stop)), np.zeros((3, w + 2))
    A[body, body], A[body, air] = model.plant.A, model.disturbance[:, None] @ model.gust.C
    A[sent, sent], A[air, air] = np.eye(chain, k=-1), model.gust.A
    B[air, :w], B[n, -1] = model.gust.B, 1.0
    # the oldest delayed command acts, or the new one at once
    if model.delay_samples:
        A[body, sent.stop - 1] = model.plant.B[:, 0]
    else:
        B[body, -1] = model.plant.B[:, 0]
    C[0, 0], C[1, n], D[1, -1] = 1.0, -1.0, 1.0
    C[2, body], D[2, w] = model.plant.C[0], model.noise
    return Lti(A=A, B=B, C=C, D=D, dt=model.plant.dt)


def mean_second_moments(flights: Sequence[AxisModel], closed: LinearSystem) -> Matrix:
    """Return the mean over the flight of the second moments of the outputs of a closed loop driven by noise alone.

    The loop's states begin with those of `augmented_axis`, once for each of `flights`. Initially the air is stationary
    and all else at rest. Arrays with leading axes are many loops at once, and may be complex.
    """
    P, _ = initial_covariance(flights, closed.A.shape[-1])
    mean = mean_covariance(closed.A, closed.B @ closed.B.mT, P, flights[0].samples)
    return np.asarray(closed.C @ mean @ closed.C.mT + closed.D @ closed.D.mT)


def initial_covariance(flights: Sequence[AxisModel], order: int) -> tuple[Matrix, list[int]]:
    """Return the covariance (n, n) of `order` n at the first sample, and the first state of each of `flights`.

    The states begin with those of `augmented_axis`, once for each. The air is stationary and all else at rest.
    """
    P, starts, end = np.zeros((order, order)), [], 0
    for model in flights:
        starts.append(end)
        begin = end + model.plant.order + max(model.delay_samples, 1)
        end = begin + model.gust.order
        P[begin:end, begin:end] = model.gust_covariance
    return P, starts


def axis_performance(model: AxisModel, law: AxisLaw) -> AxisPerformance:
    """Return error, slew and sensitivity peak of one axis, exact in the model; the loop must be stable."""
    return controller_performance(model, law.controller(model.plant.dt))


def controller_performance(model: AxisModel, controller: Lti) -> AxisPerformance:
    """Return the performance of one axis under a linear `controller` from gyro [rad/s] to command [N*m]."""
    rmse, slew = rms(model, controller)
    return AxisPerformance(
        rmse=rmse, slew=slew, sensitivity_peak=hinf_norm(sensitivity(open_loop(model, controller))).gain
    )


def pool_axes(axes: Sequence[AxisPerformance]) -> tuple[float, float]:
    """Return rms attitude [rad] and slew [N*m/s] of all axes."""
    rmse, slew = (math.sqrt(np.mean([getattr(axis, name) ** 2 for axis in axes])) for name in ("rmse", "slew"))
    return rmse, slew


def rms(model: AxisModel, controller: Lti) -> tuple[float, float]:
    """Return rms attitude [rad] and slew [N*m/s] of one axis, averaged over the flight."""
    moments = mean_second_moments([model], lft(augmented_axis(model), controller))
    return math.sqrt(moments[0, 0]), math.sqrt(moments[1, 1]) / model.plant.dt


def mean_covariance(F: Matrix, Q: Matrix, P: Matrix, count: int) -> Matrix:
    """Return the mean over `count` steps of the covariance of `x+ = F x + n`, from `P` at the first.

    `Q` is the covariance of `n`. `F` need not be stable: a gyro-only attitude is a random walk without a stationary
    covariance. Computed by doubling, in log2(count) products of size n.
    """
    # after m steps: F^m; covariance reached from 0, sum of covariances from 0, sum of F^k P F^k'
    power, m = F, 1
    reached, total, initial = sums = np.zeros(
        (3, *np.broadcast_shapes(F.shape, Q.shape, P.shape)), np.result_type(F, Q, P)
    )
    reached[:], initial[:] = Q, P
    for bit in f"{count:b}"[1:]:
        moved = power @ sums @ power.mT
        total += m * reached
        sums += moved
        power, m = power @ power, 2 * m
        if bit == "1":
            total += reached
            initial += power @ P @ power.mT
            reached[:], power, m = F @ reached @ F.mT + Q, F @ power, m + 1
    return np.asarray((total + initial) / count)


def open_loop(model: AxisModel, controller: Lti) -> Lti:
    """Return the loop broken at the plant's input, for negative feedback; the gyro does not measure attitude."""
    whole = model.plant
    plant = Lti(A=whole.A[1:, 1:], B=whole.B[1:], C=whole.C[:, 1:], D=whole.D, dt=whole.dt)
    for _ in range(model.delay_samples):
        plant = series(delay(1, whole.dt), plant)
    return -series(plant, controller)


def _axis_model(vehicle: Vehicle, scenario: Scenario, axis: int, moment: Lti, stationary: Matrix) -> AxisModel:
    inertia, lag, damping = vehicle.inertia_B[axis], vehicle.actuator_lag, vehicle.rate_damping_B[axis]
    A = np.array([[0.0, 1.0, 0.0], [0.0, -damping, 1.0 / inertia], [0.0, 0.0, -1.0 / lag]])
    B = np.array([[0.0, 0.0], [0.0, 1.0 / inertia], [1.0 / lag, 0.0]])
    held = discretize_zoh(Lti(A=A, B=B, C=np.array([[0.0, 1.0, 0.0]]), D=np.zeros((1, 2))), scenario.dt)
    noise = vehicle.gyro.noise_ratio * vehicle.gyro.reference_rate * math.sqrt(scenario.control_rate_hz / 250.0)
    return AxisModel(
        plant=held.subsystem(slice(0, 1), slice(0, 1)),
        disturbance=held.B[:, 1],
        gust=moment,
        gust_covariance=stationary,
        noise=noise * scenario.gyro.noise,
        delay_samples=scenario.delay_samples,
        inertia=inertia,
        samples=scenario.samples,
    )
