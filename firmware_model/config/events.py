"""Events at stated times of a flight, in model time: the `[[event]]` tables of a scenario.

A plant event holds from the first sample at or after `at_s` until another of its kind. Before it, the vehicle's file
and the scenario's `[gyro]` hold. It changes no gain: neither autopilot nor law is informed.
"""

import math
from typing import Annotated, Literal

from pydantic import Field

from firmware_model.config.fields import (
    Finite,
    Fraction,
    NonNegative,
    Positive,
    PositiveVector,
    Vector,
    strict_dataclass,
)

Time = Annotated[float, Field(ge=0.0, le=86_400.0)]


@strict_dataclass
class ModeChange:
    """Request for another flight mode, as from a ground station."""

    kind: Literal["mode"]
    """Names this event."""
    at_s: NonNegative
    """[s] time of the sample before which it happens."""
    mode: Literal["manual", "altctl", "posctl", "takeoff", "hold", "return", "land", "offboard", "stabilized"]
    """PX4's name of the mode; OFFBOARD is refused without a live set-point stream."""


@strict_dataclass
class ControllerHang:
    """Controller that neither receives nor sends for a while, then continues from the state it has."""

    kind: Literal["controller_hung"]
    """Names this event."""
    at_s: NonNegative
    """[s] time of the first sample that it does not receive."""
    for_s: Positive
    """[s] duration."""


@strict_dataclass
class ControllerKill:
    """End of the controller's process. Another one, without its state, may take its place."""

    kind: Literal["controller_killed"]
    """Names this event."""
    at_s: NonNegative
    """[s] time of the first sample that it does not receive."""
    recovers_after_s: Positive | None = None
    """[s] from the end until the next controller joins; never by default."""


@strict_dataclass
class AttitudeReference:
    """New attitude reference of the law; level before the first."""

    kind: Literal["attitude"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it holds for."""
    euler_deg: Vector
    """[deg] roll, pitch, yaw from the attitude that the flight begins in."""

    @property
    def euler(self) -> Vector:
        """[rad] roll, pitch, yaw."""
        phi, theta, psi = self.euler_deg
        return math.radians(phi), math.radians(theta), math.radians(psi)


@strict_dataclass
class GyroBias:
    """New gyro bias, reached at once or by linear drift."""

    kind: Literal["gyro_bias"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it changes."""
    bias_rad_s: Vector
    """[rad/s] B, added to the vehicle's bias; replaces the bias of an earlier event."""
    over_s: Time = 0.0
    """[s] duration of the drift."""


@strict_dataclass
class GyroNoise:
    """New noise level of the gyro."""

    kind: Literal["gyro_noise"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it changes."""
    factor: NonNegative
    """[-] of the vehicle's noise."""


@strict_dataclass
class GyroRange:
    """New range of the gyro."""

    kind: Literal["gyro_range"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it changes."""
    range_rad_s: Positive
    """[rad/s] largest measured magnitude."""


@strict_dataclass
class ActuatorEffect:
    """Loss of effectiveness: the actuators give a share of the commanded torque."""

    kind: Literal["actuator_effect"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it acts from."""
    share: tuple[Fraction, Fraction, Fraction]
    """[-] B, share of the torque about each axis: 1 is sound, 0 is dead."""


@strict_dataclass
class ActuatorLag:
    """New time constant of the actuators."""

    kind: Literal["actuator_lag"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it acts from."""
    lag_s: Annotated[float, Field(ge=1e-3, allow_inf_nan=False)]
    """[s] time constant."""


@strict_dataclass
class ActuatorLimit:
    """Lower torque limit of the actuators. A command of 1.0 keeps its meaning."""

    kind: Literal["actuator_limit"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it acts from."""
    torque_limit_nm: PositiveVector
    """[N*m] B, largest torque about each axis, where it is below the vehicle's own."""


@strict_dataclass
class Payload:
    """Load picked up or dropped at the centre of mass, which does not move. Loads of several events add up."""

    kind: Literal["payload"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it acts from."""
    mass_kg: Finite
    """[kg] gained, or lost if negative."""
    inertia_kgm2: Vector
    """[kg*m^2] B, principal moments of inertia gained, or lost if negative."""


PlantEvent = (
    AttitudeReference | GyroBias | GyroNoise | GyroRange | ActuatorEffect | ActuatorLag | ActuatorLimit | Payload
)
Event = Annotated[ModeChange | ControllerHang | ControllerKill | PlantEvent, Field(discriminator="kind")]
