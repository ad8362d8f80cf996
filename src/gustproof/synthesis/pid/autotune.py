"""PID gains from a frequency-response experiment that is flown, as the autotuner does with which the paper tunes.

    1. fly in still air under a weak stabilising law; add sines of five frequencies to one axis' torque command;
    2. estimate the plant's response at these frequencies from the recorded command and gyro alone;
    3. gains for the bandwidth and phase margin that were asked for, from the measured response; no model of the plant.

The experiment runs at {1/10, 1/3, 1, 3, 10} times the target bandwidth, so the inner loop is closed at the fourth and
the outer at the third: both tunings use measured points, nothing is interpolated.

References
----------
The MathWorks, Closed-Loop PID Autotuner (Simulink Control Design): perturbation at the plant's input, frequencies,
and the defaults of 1 rad/s and 60 deg.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.errors import DesignError
from gustproof.law.cascade import Gains, cascade_law, gain_parameters, plain_axis
from gustproof.law.form import Law, Matrix, Output, Provenance
from gustproof.simulate.direct import fly_direct
from gustproof.version import __version__

RATIOS = (1 / 10, 1 / 3, 1.0, 3.0, 10.0)
"""[-] frequencies of the experiment over the target bandwidth."""
_OUTER, _INNER = 2, 3
_AXES = ("roll", "pitch", "yaw")
_SETTLING, _PERIODS = 1.0, 4.0
"""Periods of the slowest sine that are flown before the record counts, and that count."""

ComplexVector = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Response:
    """Measured response of one axis, from torque command to gyro."""

    omega: Matrix
    """(5,) [rad/s] frequencies of the experiment."""
    G: ComplexVector
    """(5,) [rad/s/(N*m)] from the law's command to the gyro sample, with actuator, delay and sampling."""


def measure_response(
    vehicle: Vehicle, axis: int, *, bandwidth: float, amplitude: float, control_rate: int = 250, seed: int = 1
) -> Response:
    """Fly the experiment on one axis, direct route, with the vehicle's gyro noise, and estimate the response.

    Parameters
    ----------
    vehicle
        What is flown. Of its numbers only the inertia is used, for the strength of the weak stabilising law.
    axis
        0 roll, 1 pitch, 2 yaw.
    bandwidth
        [rad/s] target; the sines are at `RATIOS` times it.
    amplitude
        [N*m] of each of the five sines.
    control_rate
        [Hz] samples and commands.
    seed
        Of the gyro noise.

    Raises
    ------
    DesignError
        If the fastest sine is above half the sampling frequency, or the command was cut off by the torque limit.
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
        physics_rate_hz=_physics_rate(control_rate),
    )
    time = np.arange(scenario.samples) * scenario.dt
    reference = np.zeros((scenario.samples, 3))
    reference[:, axis] = amplitude * np.sin(np.outer(time, omega)).sum(axis=1)
    law = _experiment_law(vehicle, bandwidth, scenario.dt)
    records = fly_direct(scenario, law, vehicle=vehicle, seed=seed, reference=reference)
    torque, rate = records["torque_command_B"][:, axis], records["gyro_B"][:, axis]
    if np.max(np.abs(torque)) >= vehicle.torque_limit[axis]:
        raise DesignError(f"{_AXES[axis]}: the experiment reaches the torque limit; ask for a smaller amplitude")
    counted = time >= _SETTLING * period
    # The journal has what acts at a sample; the law asked for it `delay_samples` earlier.
    lead = np.exp(1j * omega * scenario.delay_samples * scenario.dt)
    U = lead * phasors(time[counted], torque[counted], omega)
    return Response(omega=omega, G=phasors(time[counted], rate[counted], omega) / U)


def tune_axis(response: Response, inertia: float, dt: float, *, phase_margin: float = math.radians(60.0)) -> Gains:
    """Return the cascade's gains: rate PI at three times the target bandwidth, then angle P at the bandwidth itself.

    The PI puts the inner loop on the unit circle with the phase margin; the outer P closes at its frequency, and its
    margin is checked.

    Parameters
    ----------
    response
        What `measure_response` returned.
    inertia
        [kg*m^2] by which torque gains are divided.
    dt
        [s] sample time.
    phase_margin
        [rad] of the inner loop exactly, of the outer at least.

    Raises
    ------
    DesignError
        If no PI gives this margin there, or the outer loop has less.
    """
    z = np.exp(1j * response.omega * dt)
    summed = dt / (z - 1.0)  # the sampled integral of the rate error
    C = -np.exp(1j * phase_margin) / response.G[_INNER]
    torque_i = C.imag / summed[_INNER].imag
    torque_p = C.real - torque_i * summed[_INNER].real
    if torque_p <= 0.0 or torque_i < 0.0:
        phase, margin = math.degrees(np.angle(response.G[_INNER])), math.degrees(phase_margin)
        raise DesignError(
            f"no rate PI has a phase margin of {margin:.0f} deg at {response.omega[_INNER]:.3g} rad/s: "
            f"the plant's phase there is {phase:.0f} deg; ask for less bandwidth or margin"
        )
    inner = (torque_p + torque_i * summed[_OUTER]) * response.G[_OUTER]
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
    """Return the two-states-an-axis cascade with gains from an experiment flown on each axis.

    Parameters
    ----------
    vehicle
        What is flown.
    name
        The law's.
    bandwidth
        [rad/s] target of the attitude loop; the tool's default.
    phase_margin
        [rad] target; the tool's default.
    amplitude
        [rad/s^2] of each sine, as angular acceleration.
    control_rate
        [Hz] samples and commands.
    seed
        Of the gyro noise in the experiment.

    Raises
    ------
    DesignError
        If the experiment can't be flown, or no gains reach the targets.

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
    provenance = Provenance(
        design="cascaded PID by an autotuner: frequency-response experiment flown, then bandwidth and phase margin",
        vehicle=vehicle.name,
        parameters={
            "bandwidth_rad_s": bandwidth,
            "phase_margin_rad": phase_margin,
            "amplitude_rad_s2": amplitude,
            "seed": float(seed),
            **gain_parameters(gains),
        },
        version=__version__,
    )
    axes = [plain_axis(g, inertia, dt) for g, inertia in zip(gains, vehicle.inertia_B, strict=True)]
    return cascade_law(name, axes, vehicle, dt, provenance)


def _experiment_law(vehicle: Vehicle, bandwidth: float, dt: float) -> Law:
    """Return the weak stabilising law, whose reference is not an attitude but torque [N*m] added to the command."""
    weak = Gains(angle_p=0.25 * bandwidth, rate_p=bandwidth, rate_i=0.0)
    axes = [plain_axis(weak, inertia, dt) for inertia in vehicle.inertia_B]
    law = cascade_law("autotune", axes, vehicle, dt, Provenance(design="experiment", vehicle=vehicle.name))
    B, D = law.B.copy(), law.D.copy()
    B[:, 3:], D[:, 3:] = 0.0, np.eye(3)
    return Law(
        name=law.name, A=law.A, B=B, C=law.C, D=D, G=law.G, H=law.H, dt=dt, limits=law.limits,
        output=Output.TORQUE, provenance=law.provenance,
    )  # fmt: skip


def phasors(time: Matrix, signal: Matrix, omega: Matrix) -> ComplexVector:
    """Return the complex amplitudes of `signal` at `omega`, by least squares beside a constant and a drift."""
    angle = np.outer(time, omega)
    trend = np.stack([np.ones_like(time), time / time[-1]], axis=1)
    found = np.linalg.lstsq(np.hstack([np.cos(angle), np.sin(angle), trend]), signal)[0]
    return np.asarray(found[: omega.size] - 1j * found[omega.size : 2 * omega.size])


def _physics_rate(control_rate: int) -> int:
    """Return the lowest multiple [Hz] of the control rate from 1 kHz on."""
    return control_rate * math.ceil(1000 / control_rate)
