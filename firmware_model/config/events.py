"""Events at stated times of a flight, in model time: the `[[event]]` tables of a scenario.

A plant event holds from the first sample at or after `at_s` until another of its kind. Before it, the vehicle's file
and the scenario's `[gyro]` hold. It changes no gain: neither autopilot nor law is informed.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from firmware_model.config.fields import (
    NOT_TRUTH,
    Finite,
    Fraction,
    NonNegative,
    Positive,
    PositiveVector,
    Tagged,
    Time,
    Vector,
    strict_dataclass,
    tagged_dataclass,
)
from firmware_model.config.vehicle import MOST_ROTORS


@strict_dataclass
class _Event(Tagged):
    """Time of an event."""

    at_s: Time
    """[s] time of the first sample that it acts on."""


@tagged_dataclass("mode")
class ModeChange(_Event):
    """Request for another flight mode, as from a ground station."""

    mode: Literal["manual", "altctl", "posctl", "takeoff", "hold", "return", "land", "offboard", "stabilized"]
    """PX4's name of the mode; OFFBOARD is refused without a live set-point stream."""


@tagged_dataclass("controller_hung")
class ControllerHang(_Event):
    """Controller that neither receives nor sends for a while, then continues from the state it has."""

    for_s: Positive
    """[s] duration."""


@tagged_dataclass("controller_killed")
class ControllerKill(_Event):
    """End of the controller's process. Another one, without its state, may take its place."""

    recovers_after_s: Positive | None = None
    """[s] from the end until the next controller joins; never by default."""


@tagged_dataclass("attitude")
class AttitudeReference(_Event):
    """New attitude reference of the law; level before the first."""

    euler_deg: Vector
    """[deg] roll, pitch, yaw from the attitude that the flight begins in."""

    @property
    def euler(self) -> Vector:
        """[rad] roll, pitch, yaw."""
        phi, theta, psi = self.euler_deg
        return math.radians(phi), math.radians(theta), math.radians(psi)


@tagged_dataclass("gyro_bias")
class GyroBias(_Event):
    """New gyro bias, reached at once or by linear drift."""

    bias_rad_s: Vector
    """[rad/s] B, added to the vehicle's bias; replaces the bias of an earlier event."""
    over_s: Time = 0.0
    """[s] duration of the drift."""


@tagged_dataclass("gyro_noise")
class GyroNoise(_Event):
    """New noise level of the gyro."""

    factor: NonNegative
    """[-] of the vehicle's noise."""


@tagged_dataclass("gyro_range")
class GyroRange(_Event):
    """New range of the gyro."""

    range_rad_s: Positive
    """[rad/s] largest measured magnitude."""


@tagged_dataclass("actuator_effect")
class ActuatorEffect(_Event):
    """Loss of effectiveness: the actuators give a share of the commanded torque."""

    share: tuple[Fraction, Fraction, Fraction]
    """[-] B, share of the torque about each axis: 1 is sound, 0 is dead."""


@tagged_dataclass("actuator_lag")
class ActuatorLag(_Event):
    """New time constant of the actuators."""

    lag_s: Annotated[float, Field(ge=1e-3, allow_inf_nan=False), NOT_TRUTH]
    """[s] time constant."""


@tagged_dataclass("actuator_limit")
class ActuatorLimit(_Event):
    """Lower torque limit of the actuators. A command of 1.0 keeps its meaning."""

    torque_limit_nm: PositiveVector
    """[N*m] B, largest torque about each axis, where it is below the vehicle's own."""


@tagged_dataclass("payload")
class Payload(_Event):
    """Load picked up or dropped at the centre of mass, which does not move. Loads of several events add up.

    It is stated as shares of what the vehicle has before the event, for any vehicle, or absolute, for one.
    """

    mass_kg: Finite = 0.0
    """[kg] gained, or lost if negative."""
    inertia_kgm2: Vector = (0.0, 0.0, 0.0)
    """[kg*m^2] B, principal moments of inertia gained, or lost if negative."""
    mass_share: Finite = 0.0
    """[-] of the mass gained, or lost if negative."""
    inertia_share: Vector = (0.0, 0.0, 0.0)
    """[-] B, of each principal moment of inertia gained, or lost if negative."""

    @model_validator(mode="after")
    def _check_load(self) -> Self:
        if not any((self.mass_kg, *self.inertia_kgm2, self.mass_share, *self.inertia_share)):
            raise ValueError("mass_kg or mass_share: nothing is gained or lost")
        return self


@tagged_dataclass("rotor_failure")
class RotorFailure(_Event):
    """Rotor that gives a share of its thrust and drag torque, at once and in free flight only.

    On the test stand torques have actuators of their own: see `ActuatorEffect`.
    """

    rotor: Annotated[int, Field(ge=1, le=MOST_ROTORS), NOT_TRUTH]
    """Number of the rotor in the vehicle's file, from 1."""
    share: Fraction = 0.0
    """[-] of the thrust that it is to give: 1 is sound, 0 is dead."""


@tagged_dataclass("gps_lost")
class GpsLoss(_Event):
    """Satellite receiver without a fix, in flights of a real autopilot: no law here reads one."""

    for_s: Positive | None = None
    """[s] duration; to the end by default."""


PlantEvent = (
    AttitudeReference
    | GyroBias
    | GyroNoise
    | GyroRange
    | ActuatorEffect
    | ActuatorLag
    | ActuatorLimit
    | Payload
    | RotorFailure
)
ControllerEvent = ModeChange | ControllerHang | ControllerKill
Event = Annotated[ControllerEvent | PlantEvent | GpsLoss, Field(discriminator="kind")]
