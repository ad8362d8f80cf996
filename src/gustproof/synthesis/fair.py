"""The fair baseline: the strapdown cascade with the gains that hold attitude best in turbulence.

"Best" has its price stated: least error at a given sensitivity peak of each axis and a given torque slew. The model is
exact for small angles: plant, actuator and commands on their way at the sample rate, the vehicle's own Dryden filters
and gust map, white gyro noise. Left out are the angular gusts, which act through the rate damping alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

import gustproof
from firmware_model.gusts import dryden_filters, dryden_spectrum, gust_moment
from firmware_model.scenario import Scenario
from firmware_model.vehicle import Vehicle
from firmware_model.wind import Dryden
from gustproof.errors import DesignError
from gustproof.law import Law, Matrix, Provenance
from gustproof.numerics.lti import Lti, delay, hold_discretized, sensitivity, series
from gustproof.numerics.norms import hinf_norm
from gustproof.synthesis.pid import AxisLaw, Gains, cascade_law, gain_parameters, strapdown_axis

_GRID = 200
"""Frequencies, evenly spaced in the logarithm, at which the search keeps the sensitivity peak."""
_BETWEEN = 1e-3
"""[-] share of the peak kept back for what the sensitivity may rise between two frequencies of the grid."""
_ROUNDING = 1e-6
"""[-] share of the slew kept back, because the search meets a limit to rounding only."""
_START = Gains(angle_p=4.0, rate_p=8.0, rate_i=16.0, rate_d=0.3, derivative_cutoff=30.0)
"""Where the search starts: a calm cascade, sound for an actuator lag up to .05 s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisFigures:
    """What the model foretells for one axis under its law."""

    rmse: float
    """[rad] root mean square attitude over the scenario, of all flights."""
    slew: float
    """[N*m/s] root mean square of the command's change from sample to sample over the sample time."""
    sensitivity_peak: float
    """[-] largest magnitude of 1 / (1 + L) over frequency, the loop being cut at the plant's input."""


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
    """Samples from a measurement to the moment its command acts."""
    inertia: float
    """[kg*m^2]."""
    samples: int
    """Samples of the flight."""


def axis_models(vehicle: Vehicle, scenario: Scenario) -> tuple[AxisModel, AxisModel, AxisModel]:
    """Return the models of roll, pitch and yaw in the scenario's turbulence.

    Raises
    ------
    ValueError
        If the scenario has no Dryden turbulence.
    """
    dryden = next((item for item in scenario.wind if isinstance(item, Dryden)), None)
    if dryden is None:
        raise ValueError(f"scenario '{scenario.name}' has no turbulence to design for")
    spectrum = dryden_spectrum(dryden, scenario.altitude_m, vehicle.span)
    f, factor = dryden_filters(spectrum, vehicle.span, scenario.dt)
    covariance = factor @ factor.T
    map_B = np.array([gust_moment(vehicle.gust_gain, vehicle.gust_yaw_ratio, tuple(e)) for e in np.eye(3)]).T
    filters = (
        (np.array([[f.u_a]]), np.array([[f.u_b]]), np.array([[1.0]]), covariance[:1, :1]),
        (_lower(f.v_a11, f.v_a21, f.v_a22), _lower(f.v_b11, f.v_b21, f.v_b22), np.array([[f.v_c1, f.v_c2]]),
         covariance[1:3, 1:3]),
        (_lower(f.w_a11, f.w_a21, f.w_a22), _lower(f.w_b11, f.w_b21, f.w_b22), np.array([[f.w_c1, f.w_c2]]),
         covariance[4:6, 4:6]),
    )  # fmt: skip
    models = []
    for axis, inertia in enumerate(vehicle.inertia_B):
        component = int(np.argmax(np.abs(map_B[axis])))
        A, B, C, stationary = filters[component]
        moment = Lti(A=A, B=B, C=map_B[axis, component] * C, D=np.zeros((1, B.shape[1])), dt=scenario.dt)
        models.append(_axis_model(vehicle, scenario, inertia, moment, stationary))
    return models[0], models[1], models[2]


def axis_figures(model: AxisModel, law: AxisLaw) -> AxisFigures:
    """Return error, slew and sensitivity peak of one axis, exact in the model; the law must be stable there."""
    rmse, slew = _rms(model, law)
    return AxisFigures(rmse=rmse, slew=slew, sensitivity_peak=hinf_norm(sensitivity(_loop(model, law))).gain)


def tune_fair(
    vehicle: Vehicle, scenario: Scenario, *, sensitivity_peak: float = 1.36, slew: float = 19.9
) -> tuple[Gains, Gains, Gains]:
    """Return the gains of roll, pitch and yaw with the least attitude error, pooled over the axes.

    Sequential quadratic programming (SLSQP) on the logarithms of the fifteen gains, from one fixed start: the same
    gains every time. It finds a local optimum.

    Parameters
    ----------
    vehicle, scenario
        What is flown; turbulence, delay, sample time and duration are the scenario's.
    sensitivity_peak
        [-] largest sensitivity peak of each axis.
    slew
        [N*m/s] largest rms torque slew, pooled over the three axes; the default leaves a single flight's scatter
        below 20.

    Raises
    ------
    DesignError
        If no such gains are found: the demands are too tight for this vehicle.
    """
    models = axis_models(vehicle, scenario)
    best = _minimized(models, sensitivity_peak, slew)
    figures = [axis_figures(m, strapdown_axis(g, m.inertia, scenario.dt)) for m, g in zip(models, best, strict=True)]
    worst = max(axis.sensitivity_peak for axis in figures)
    pooled = math.sqrt(np.mean([axis.slew**2 for axis in figures]))
    if worst > sensitivity_peak or pooled > slew:
        raise DesignError(
            f"no cascade found at sensitivity peak {sensitivity_peak} and slew {slew} N*m/s: "
            f"the best had {worst:.4f} and {pooled:.4f}"
        )
    return best


def fair_pid(
    vehicle: Vehicle, scenario: Scenario, *, name: str = "pid-fair", sensitivity_peak: float = 1.36, slew: float = 19.9
) -> Law:
    """Return the law with the gains of `tune_fair`; its provenance has gains and demands.

    Raises
    ------
    DesignError
        See `tune_fair`.
    """
    gains = tune_fair(vehicle, scenario, sensitivity_peak=sensitivity_peak, slew=slew)
    axes = [strapdown_axis(g, inertia, scenario.dt) for g, inertia in zip(gains, vehicle.inertia_B, strict=True)]
    provenance = Provenance(
        design=f"strapdown cascade, gains of least attitude error in scenario '{scenario.name}'",
        vehicle=vehicle.name,
        parameters={"sensitivity_peak": sensitivity_peak, "slew_nm_per_s": slew, **gain_parameters(gains)},
        version=gustproof.__version__,
    )
    return cascade_law(name, axes, vehicle, scenario.dt, provenance)


def mean_covariance(F: Matrix, Q: Matrix, P: Matrix, count: int) -> Matrix:
    """Return the mean over `count` steps of the covariance of `x+ = F x + n`, from `P` at the first.

    `Q` is the covariance of `n`. Works where `F` is not stable, as a gyro-only attitude is not: its noise is a random
    walk, and a stationary covariance does not exist. By doubling, in log2(count) products of size n.
    """
    n = F.shape[0]
    # Of m steps: F^m, covariance reached from 0, sum of covariances from 0, sum of F^k P F^k'.
    power, reached, total, carried = np.eye(n), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    m = 0
    for bit in f"{count:b}":
        total = total + m * reached + power @ total @ power.T
        carried = carried + power @ carried @ power.T
        reached = reached + power @ reached @ power.T
        power, m = power @ power, 2 * m
        if bit == "1":
            total, carried = total + reached, carried + power @ P @ power.T
            reached, power, m = F @ reached @ F.T + Q, F @ power, m + 1
    return np.asarray((total + carried) / count)


def _minimized(models: Sequence[AxisModel], peak: float, slew: float) -> tuple[Gains, Gains, Gains]:
    dt = models[0].plant.dt
    omega = np.geomspace(1.0, 0.999 * math.pi / dt, _GRID)
    responses = [m.plant.response(omega)[:, 0, 0] * np.exp(-1j * omega * dt * m.delay_samples) for m in models]
    start = np.tile(np.log([_START.angle_p, _START.rate_p, _START.rate_i, _START.rate_d, _START.derivative_cutoff]), 3)

    def laws(z: Matrix) -> list[AxisLaw]:
        return [strapdown_axis(g, m.inertia, dt) for g, m in zip(_gains(z), models, strict=True)]

    def figures(z: Matrix) -> tuple[float, float]:
        rms = np.array([_rms(model, law) for model, law in zip(models, laws(z), strict=True)])
        rmse, pooled = np.sqrt(np.mean(rms**2, axis=0))
        return math.log(rmse), math.log(pooled)

    def error(z: Matrix) -> float:
        return figures(z)[0]

    def margins(z: Matrix) -> Matrix:
        loops = [-_controller(law, dt).response(omega)[:, 0, 0] * G for law, G in zip(laws(z), responses, strict=True)]
        room = np.concatenate([np.log(np.abs(1.0 + L)) for L in loops]) + math.log(peak * (1.0 - _BETWEEN))
        return np.append(room, math.log(slew * (1.0 - _ROUNDING)) - figures(z)[1])

    room = scipy.optimize.NonlinearConstraint(margins, 0.0, np.inf)
    bounds = [(math.log(1e-3), math.log(1e4))] * 15
    found = scipy.optimize.minimize(
        error, start, method="SLSQP", bounds=bounds, constraints=room, options={"maxiter": 300, "ftol": 1e-9}
    )
    return _gains(found.x)


def _gains(z: Matrix) -> tuple[Gains, Gains, Gains]:
    roll, pitch, yaw = (
        Gains(angle_p=a, rate_p=p, rate_i=i, rate_d=d, derivative_cutoff=c)
        for a, p, i, d, c in np.exp(z).reshape(3, 5).tolist()
    )
    return roll, pitch, yaw


def _rms(model: AxisModel, law: AxisLaw) -> tuple[float, float]:
    """Return rms attitude [rad] and slew [N*m/s], averaged over the flight; the air is stationary, the rest at rest."""
    dt, chain = model.plant.dt, max(model.delay_samples, 1)
    n, m, k = model.plant.order, model.gust.order, law.A.shape[0]
    body, sent = slice(0, n), slice(n, n + chain)
    air, own = slice(n + chain, n + chain + m), slice(n + chain + m, n + chain + m + k)
    rate = np.zeros(own.stop)
    rate[body] = model.plant.C[0]
    command = law.D[0, 0] * rate
    command[own] = law.C[0]
    # The oldest command on its way acts, or the new one at once.
    acting = np.eye(own.stop)[sent][-1] if model.delay_samples else command
    F = np.zeros((own.stop, own.stop))
    F[body, body] = model.plant.A
    F[body] += model.plant.B @ acting[None]
    F[body, air] += model.disturbance[:, None] @ model.gust.C
    F[sent] = np.vstack([command, np.eye(own.stop)[sent][:-1]])
    F[air, air] = model.gust.A
    F[own, own] = law.A_linear
    F[own] += law.B[:, :1] @ rate[None]
    jump = np.zeros(own.stop)  # of the noise of the gyro
    jump[n], jump[own] = law.D[0, 0], law.B[:, 0]
    if not model.delay_samples:
        jump[body] = model.plant.B[:, 0] * law.D[0, 0]
    Q = model.noise**2 * np.outer(jump, jump)
    Q[air, air] += model.gust.B @ model.gust.B.T
    P = np.zeros_like(F)
    P[air, air] = model.gust_covariance
    mean = mean_covariance(F, Q, P, model.samples)
    change = command - np.eye(own.stop)[n]
    slew = change @ mean @ change + (law.D[0, 0] * model.noise) ** 2
    return math.sqrt(mean[0, 0]), math.sqrt(slew) / dt


def _loop(model: AxisModel, law: AxisLaw) -> Lti:
    """Return the loop cut at the plant's input, for negative feedback; the gyro does not see the attitude itself."""
    dt = model.plant.dt
    controller = _controller(law, dt)
    whole = model.plant
    plant = Lti(A=whole.A[1:, 1:], B=whole.B[1:], C=whole.C[:, 1:], D=whole.D, dt=dt)
    for _ in range(model.delay_samples):
        plant = series(delay(1, dt), plant)
    loop = series(plant, controller)
    return Lti(A=loop.A, B=loop.B, C=-loop.C, D=-loop.D, dt=dt)


def _controller(law: AxisLaw, dt: float) -> Lti:
    return Lti(A=law.A_linear, B=law.B[:, :1], C=law.C, D=law.D[:, :1], dt=dt)


def _axis_model(vehicle: Vehicle, scenario: Scenario, inertia: float, moment: Lti, stationary: Matrix) -> AxisModel:
    lag, damping = vehicle.actuator_lag, vehicle.rate_damping
    continuous = Lti(
        A=np.array([[0.0, 1.0, 0.0], [0.0, -damping, 1.0 / inertia], [0.0, 0.0, -1.0 / lag]]),
        B=np.array([[0.0, 0.0], [0.0, 1.0 / inertia], [1.0 / lag, 0.0]]),
        C=np.array([[0.0, 1.0, 0.0]]),
        D=np.zeros((1, 2)),
    )
    held = hold_discretized(continuous, scenario.dt)
    noise = vehicle.gyro.noise_ratio * vehicle.gyro.reference_rate * math.sqrt(scenario.control_rate_hz / 250.0)
    return AxisModel(
        plant=held.part(slice(0, 1), slice(0, 1)),
        disturbance=held.B[:, 1],
        gust=moment,
        gust_covariance=stationary,
        noise=noise * scenario.gyro.noise,
        delay_samples=scenario.delay_samples,
        inertia=inertia,
        samples=scenario.samples,
    )


def _lower(a11: float, a21: float, a22: float) -> Matrix:
    return np.array([[a11, 0.0], [a21, a22]])
