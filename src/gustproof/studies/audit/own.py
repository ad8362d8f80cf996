"""Our own simulator, audited through the same interface as any other."""

from dataclasses import replace
from typing import Literal

import numpy as np

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.config.waveforms import Constant
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import RotorCommand
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import GYRO_REFERENCE_SIZE, Law, Output, Provenance
from gustproof.studies.audit.simulator import HEIGHT, Airframe, Array, FlightStart, RequestedAir, Simulator, TrueMotion
from gustproof.version import __version__


class OwnSimulator(Simulator):
    """The simulator of `gustproof fly`, stepped by rotor commands."""

    name = f"gustproof {__version__}"

    def __init__(self, vehicle: Vehicle | None = None) -> None:
        self._vehicle = vehicle or load_vehicle("iris")

    @property
    def airframe(self) -> Airframe:
        """The vehicle's file."""
        vehicle, rotors = self._vehicle, self._vehicle.rotors
        return Airframe(
            mass=vehicle.mass,
            inertia_B=vehicle.inertia_B,
            position_B=rotors.position_B,
            spin=rotors.spin,
            drag_ratio=rotors.drag_ratio,
            thrust_max=rotors.thrust_max,
            thrust_square=0.0,
            actuator_lag=vehicle.actuator_lag,
        )

    def reset(self, seed: int, dt: float, air: RequestedAir, start: FlightStart) -> TrueMotion:
        """Begin a free flight."""
        self._loop = VehicleLoop(self._vehicle, _scenario(dt, air, "free"), seed)
        self._loop.settle_rotors(start.rotors.tolist(), start.omega_B)
        return self._motion()

    def step(self, rotors: Array) -> TrueMotion:
        """Fly a sample."""
        command = RotorCommand(self._loop.time_us, tuple(rotors.tolist()), False)
        self._loop.advance(command, Mode.OFFBOARD.value)
        return self._motion()

    def sample_air(self, seed: int, dt: float, air: RequestedAir, samples: int) -> Array:
        """Return mean wind and gusts at a vehicle on the test stand, where a gust's axes are those of the stand."""
        scenario = replace(_scenario(dt, air, "held"), duration_s=samples * dt)
        records = fly_direct(scenario, _motors_only(dt), vehicle=self._vehicle, seed=seed)
        return np.asarray(records["gust_B"] + records["wind_N"])

    def _motion(self) -> TrueMotion:
        loop = self._loop
        loop.observe()
        return TrueMotion(loop.true_vector("velocity_N"), loop.q_NB, loop.true_vector("omega_B"))


def _scenario(dt: float, air: RequestedAir, translation: Literal["held", "free"]) -> Scenario:
    turbulence = () if air.turbulence is None else (air.turbulence,)
    return replace(
        load_scenario("calm"),
        duration_s=86_400.0,
        translation=translation,
        altitude_m=HEIGHT,
        control_rate_hz=round(1.0 / dt),
        delay_samples=0,
        wind=(Constant(kind="constant", velocity_mps=air.wind_N), *turbulence),
    )


def _motors_only(dt: float) -> Law:
    """Return a law without states that commands no torque."""
    none = np.zeros((0, 3))
    return Law(
        name="none",
        A=none[:, :0],
        B=np.zeros((0, GYRO_REFERENCE_SIZE)),
        C=none.T,
        D=np.zeros((3, GYRO_REFERENCE_SIZE)),
        G=none,
        H=none,
        dt=dt,
        limits=np.ones(3),
        output=Output.TORQUE,
        provenance=Provenance(design="no torque", vehicle="any"),
    )
