from collections.abc import Callable

import numpy as np
import pytest

from firmware_model.config.vehicle import Vehicle
from gustproof.identification.identification import AxisEstimate, Identification, Interval
from gustproof.logs.flight_log import CommandUnit, FlightLog, Signal
from gustproof.types import Records


def around(value: float, share: float = 0.05) -> Interval:
    return Interval(value * (1.0 - share), value, value * (1.0 + share))


@pytest.fixture
def log_of() -> Callable[[Records], FlightLog]:
    """Return what turns a flight into a log of torques in N m."""

    def convert(records: Records) -> FlightLog:
        time = records["time_us"] * 1e-6
        return FlightLog(
            source="flight.mcap",
            system="gustproof",
            gyro=Signal(time=time, values=records["gyro_B"]),
            command=Signal(time=time, values=records["torque_command_B"]),
            command_unit=CommandUnit.NEWTON_METRES,
            airborne=((float(time[0]), float(time[-1])),),
        )

    return convert


@pytest.fixture
def perfect() -> Callable[..., Identification]:
    """Return what makes a vehicle's identification without error."""

    def make(vehicle: Vehicle, *, unit: CommandUnit = CommandUnit.NEWTON_METRES, dt: float = 0.004) -> Identification:
        omega, time = np.geomspace(0.5, 100.0, 40), np.arange(0.0, 30.0, dt)
        lag = 1.0 / (1.0 + 1j * omega * vehicle.actuator_lag)
        model = np.array([lag / inertia for inertia in vehicle.inertia_B])
        acceleration = np.stack([np.sin(time + k) for k in range(3)], axis=1)
        axes = [
            AxisEstimate(
                gain=around(1.0 / inertia),
                damping=around(damping),
                noise=vehicle.gyro.noise_density,
                disturbance_rms=1.0,
                disturbance_corner=1.0,
                held_out_r2=0.9,
            )
            for inertia, damping in zip(vehicle.inertia_B, vehicle.rate_damping_B, strict=True)
        ]
        return Identification(
            source="flight.mcap",
            dt=dt,
            command_unit=unit,
            actuator_lag=around(vehicle.actuator_lag),
            delay=Interval(0.0, 0.0, 0.001),
            axes=(axes[0], axes[1], axes[2]),
            motor_gains=None,
            motor_intervals=None,
            omega=omega,
            response=model * 1.02,
            model=model,
            coherence=np.full((3, len(omega)), 0.9),
            time=time,
            acceleration=acceleration,
            predicted=0.95 * acceleration,
            findings=(),
        )

    return make
