"""Tune PID gains from a frequency-response experiment in flight, as the paper's autotuner does.

    1. Fly in still air under a weak stabilising law; add sines of five frequencies to one axis' torque command.
    2. Estimate the plant's response at these frequencies from the recorded command and gyro alone.
    3. Compute gains for the target bandwidth and phase margin from the measured response, without a plant model.

The frequencies are {1/10, 1/3, 1, 3, 10} times the target bandwidth. The inner loop is closed at the fourth and the
outer at the third: both tunings use measured points, without interpolation.

References
----------
The MathWorks, Closed-Loop PID Autotuner (Simulink Control Design): perturbation at the plant's input, frequencies,
and the defaults of 1 rad/s and 60 deg.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.types import AXES
from gustproof.errors import DesignError
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.cascade import Gains, cascade_law, gain_parameters, plain_axis
from gustproof.law.form import Law, Matrix, Provenance

RATIOS = (1 / 10, 1 / 3, 1.0, 3.0, 10.0)
"""[-] frequencies of the experiment over the target bandwidth."""
_OUTER, _INNER = 2, 3
_SETTLING, _PERIODS = 1.0, 4.0
"""Periods of the slowest sine before the evaluated part of the record, and in it."""

ComplexVector = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Response:
    """Measured response of one axis, from torque command to gyro."""

    omega: Matrix
    """(5,) [rad/s] frequencies of the experiment."""
    G: ComplexVector
    """(5,) [rad/s/(N*m)] from the law's command to the gyro sample, including actuator, delay and sampling."""


def measure_response(
    vehicle: Vehicle, axis: int, *, bandwidth: float, amplitude: float, control_rate: int = 250, seed: int = 1
) -> Response:
    """Fly the experiment on one axis, direct route, with the vehicle's gyro noise, and estimate the response.

    Of the vehicle's parameters the tuner uses only the inertia, for the gains of the weak stabilising law. The sines
    are at `RATIOS` times the target `bandwidth` [rad/s], each of `amplitude` [N*m]; samples and commands come at
    `control_rate` [Hz].

    Raises
    ------
    DesignError
        If the fastest sine is above half the sampling frequency, or the command reached the torque limit.
    """
    omega = bandwidth * np.array(RATIOS)
    if omega[-1] >= math.pi * control_rate:
        raise DesignError(f"bandwidth {bandwidth} rad/s is too fast to be measured at {control_rate} Hz")
    period = 2.0 * math.pi / omega[0]
    scenario = Scenario(
        name="autotune",
        description="frequency-response experiment in still air",
        duration_s=math.ceil((_SETTLING + _PERIODS) * period),
        control_rate_hz=control_rate,
        physics_rate_hz=control_rate * math.ceil(1000 / control_rate),  # at least 1 kHz
    )
    time = np.arange(scenario.samples) * scenario.dt
    reference = np.zeros((scenario.samples, 3))
    reference[:, axis] = amplitude * np.sin(np.outer(time, omega)).sum(axis=1)
    law = _experiment_law(vehicle, bandwidth, scenario.dt)
    records = fly_direct(scenario, law, vehicle=vehicle, seed=seed, reference=reference)
    torque, rate = records["torque_command_B"][:, axis], records["gyro_B"][:, axis]
    if np.max(np.abs(torque)) >= vehicle.torque_limit[axis]:
        raise DesignError(f"{AXES[axis]}: the experiment reaches the torque limit; ask for a smaller amplitude")
    counted = time >= _SETTLING * period
    # the journal has the command that acts at a sample; the law sent it `delay_samples` earlier
    lead = np.exp(1j * omega * scenario.delay_samples * scenario.dt)
    U = lead * phasors(time[counted], torque[counted], omega)
    return Response(omega=omega, G=phasors(time[counted], rate[counted], omega) / U)


def tune_axis(response: Response, inertia: float, dt: float, *, phase_margin: float = math.radians(60.0)) -> Gains:
    """Return the cascade's gains: rate PI at three times the target bandwidth, then angle P at the bandwidth itself.

    The PI gives the inner loop unit gain and the phase margin at its frequency. The P gives the outer loop unit gain at
    its own; the phase margin there is checked. `phase_margin` [rad] is that of the inner loop, and the least of the
    outer. The `inertia` [kg*m^2] divides the torque gains; `dt` [s] is the sample time.

    Raises
    ------
    DesignError
        If no PI gives this margin there, or the outer loop has less.
    """
    z = np.exp(1j * response.omega * dt)
    integral = dt / (z - 1.0)  # the sampled integral of the rate error
    C = -np.exp(1j * phase_margin) / response.G[_INNER]
    torque_i = C.imag / integral[_INNER].imag
    torque_p = C.real - torque_i * integral[_INNER].real
    if torque_p <= 0.0 or torque_i < 0.0:
        phase, margin = math.degrees(np.angle(response.G[_INNER])), math.degrees(phase_margin)
        raise DesignError(
            f"no rate PI has a phase margin of {margin:.0f} deg at {response.omega[_INNER]:.3g} rad/s: "
            f"the plant's phase there is {phase:.0f} deg; ask for less bandwidth or margin"
        )
    inner = (torque_p + torque_i * integral[_OUTER]) * response.G[_OUTER]
    attitude = 0.5 * dt * (z[_OUTER] + 1.0) / (z[_OUTER] - 1.0) * inner / (1.0 + inner)
    margin = math.pi + float(np.angle(attitude))
    if margin < phase_margin:
        raise DesignError(f"the attitude loop has a phase margin of {math.degrees(margin):.0f} deg only")
    return Gains(angle_p=float(1.0 / abs(attitude)), rate_p=float(torque_p / inertia), rate_i=float(torque_i / inertia))


def autotune_pid(
    vehicle: Vehicle,
    *,
    name: str = "pid-default",
    bandwidth: float = 1.0,
    phase_margin: float = math.radians(60.0),
    amplitude: float = 0.05,
    control_rate: int = 250,
    seed: int = 1,
) -> Law:
    """Return the cascade of two states an axis, with gains from a flight experiment on each axis.

    `bandwidth` [rad/s] and `phase_margin` [rad] are the targets of the attitude loop; they default to those of the
    paper's tool. Each sine of the experiment has the `amplitude` [rad/s^2], as angular acceleration. Samples and
    commands come at `control_rate` [Hz].

    Raises
    ------
    DesignError
        If the experiment cannot be flown, or no gains reach the targets.

    Examples
    --------
    >>> from gustproof import autotune_pid, load_vehicle
    >>> law = autotune_pid(load_vehicle("iris"), bandwidth=1.0)
    >>> (law.order, law.dt)
    (6, 0.004)
    """
    dt, gains = 1.0 / control_rate, []
    for axis, inertia in enumerate(vehicle.inertia_B):
        response = measure_response(
            vehicle, axis, bandwidth=bandwidth, amplitude=amplitude * inertia, control_rate=control_rate, seed=seed
        )
        gains.append(tune_axis(response, inertia, dt, phase_margin=phase_margin))
    targets = {"bandwidth_rad_s": bandwidth, "phase_margin_rad": phase_margin}
    provenance = Provenance.of(
        vehicle,
        "cascaded PID by an autotuner: frequency-response experiment flown, then bandwidth and phase margin",
        {**targets, "amplitude_rad_s2": amplitude, "seed": float(seed), **gain_parameters(gains)},
    )
    axes = [plain_axis(g, inertia, dt) for g, inertia in zip(gains, vehicle.inertia_B, strict=True)]
    return cascade_law(name, axes, vehicle, dt, provenance)


def _experiment_law(vehicle: Vehicle, bandwidth: float, dt: float) -> Law:
    """Return the weak stabilising law; its reference is a torque [N*m] added to the command, not an attitude."""
    weak = Gains(angle_p=0.25 * bandwidth, rate_p=bandwidth, rate_i=0.0)
    axes = [plain_axis(weak, inertia, dt) for inertia in vehicle.inertia_B]
    law = cascade_law("autotune", axes, vehicle, dt, Provenance(design="experiment", vehicle=vehicle.name))
    B, D = law.B.copy(), law.D.copy()
    B[:, 3:], D[:, 3:] = 0.0, np.eye(3)
    return replace(law, B=B, D=D)


def phasors(time: Matrix, signal: Matrix, omega: Matrix) -> ComplexVector:
    """Return the complex amplitudes of `signal` at `omega`, by least squares together with a constant and a drift."""
    angle = np.outer(time, omega)
    trend = np.stack([np.ones_like(time), time / time[-1]], axis=1)
    found = np.linalg.lstsq(np.hstack([np.cos(angle), np.sin(angle), trend]), signal)[0]
    return np.asarray(found[: omega.size] - 1j * found[omega.size : 2 * omega.size])
