"""Identify the autopilot's rate loop from flight, the actuator of a law that commands body rates."""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.design.cascades.autotune import ComplexVector, phasors
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import Law, Matrix, Output, Provenance

_OMEGA = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
"""[rad/s] sines of the experiment: the band in which an attitude law works."""
_PERIOD = 2.0 * math.pi / _OMEGA[0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateLoop:
    """Rate set-point to rate as a first-order lag on each axis, with the misfit."""

    tau: Matrix
    """(3,) [s] B, time constants."""
    misfit: Matrix
    """(3,) [-] B, largest distance between measured and fitted response at the sines, for a set-point of 1."""


def identify_rate_loop(vehicle: Vehicle, *, amplitude: float = 0.05, seed: int = 1) -> RateLoop:
    """Fly sines of five frequencies on each axis' rate set-point, in still air with gyro noise, and fit a lag.

    The vehicle flies with its on-board gains. Each sine has the `amplitude` [rad/s].

    Examples
    --------
    >>> from gustproof import identify_rate_loop, load_vehicle
    >>> found = identify_rate_loop(load_vehicle("paper"))
    >>> [round(float(tau), 2) for tau in found.tau]
    [0.13, 0.13, 0.13]
    """
    responses = [_measure_response(vehicle, axis, amplitude, seed) for axis in range(3)]
    tau = np.array([_fit_lag(G) for G in responses])
    misfit = [float(np.max(np.abs(G - 1.0 / (1.0 + 1j * _OMEGA * t)))) for G, t in zip(responses, tau, strict=True)]
    return RateLoop(tau=tau, misfit=np.array(misfit))


def _measure_response(vehicle: Vehicle, axis: int, amplitude: float, seed: int) -> ComplexVector:
    """Return the measured response (5,) from the acting rate set-point to the gyro."""
    scenario = Scenario(name="identify", description="rate loop", duration_s=math.ceil(4.0 * _PERIOD))
    time = np.arange(scenario.samples) * scenario.dt
    reference = np.zeros((scenario.samples, 3))
    reference[:, axis] = amplitude * np.sin(np.outer(time, _OMEGA)).sum(axis=1)
    # the excitation enters as the reference, which this law passes on as the set-point
    excite = Law(
        name="excite",
        A=np.zeros((1, 1)),
        B=np.zeros((1, 6)),
        C=np.zeros((3, 1)),
        D=np.eye(3, 6, 3),
        G=np.zeros((1, 3)),
        H=np.zeros((1, 3)),
        dt=scenario.dt,
        limits=np.full(3, vehicle.stabilizer.rate_limit),
        output=Output.RATES,
        provenance=Provenance(design="identification", vehicle=vehicle.name),
    )
    records = fly_direct(scenario, excite, vehicle=vehicle, seed=seed, reference=reference)
    counted = time >= _PERIOD
    setpoint = phasors(time[counted], records["omega_command_B"][counted, axis], _OMEGA)
    return phasors(time[counted], records["gyro_B"][counted, axis], _OMEGA) / setpoint


def _fit_lag(G: ComplexVector) -> float:
    """Return the time constant [s] of the first-order lag nearest to the response `G` (5,)."""

    def distance(tau: float) -> float:
        return float(np.sum(np.abs(G - 1.0 / (1.0 + 1j * _OMEGA * tau)) ** 2))

    return float(
        scipy.optimize.minimize_scalar(distance, bounds=(1e-3, 2.0), method="bounded", options={"xatol": 1e-6}).x
    )
