"""What happens to vehicle and reference at stated times of a flight: `[[event]]` tables, in model time.

An event holds from the first sample at or after `at_s` until another of its kind; what was there before is the
vehicle's file and the scenario's `[gyro]`. Neither autopilot nor law is told: their gains stay what they are.
"""

import math
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from firmware_model.config.vehicle import Finite, NonNegative, Positive, PositiveVector, Vector
from firmware_model.config.wind import STRICT

Time = Annotated[float, Field(ge=0.0, le=86_400.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class AttitudeReference:
    """Another attitude that the law is asked to hold; level before the first."""

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


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GyroBias:
    """Another bias of the gyro, at once or drifting there linearly."""

    kind: Literal["gyro_bias"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it changes."""
    bias_rad_s: Vector
    """[rad/s] B, added to the vehicle's bias, in the place of what was."""
    over_s: Time = 0.0
    """[s] how long it takes to get there."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GyroNoise:
    """More or less noise of the gyro."""

    kind: Literal["gyro_noise"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it changes."""
    factor: NonNegative
    """[-] of the vehicle's noise."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GyroRange:
    """Another range of the gyro."""

    kind: Literal["gyro_range"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it changes."""
    range_rad_s: Positive
    """[rad/s] largest magnitude that is measured."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ActuatorEffect:
    """Loss of effect: the actuators give a share of what is asked of them."""

    kind: Literal["actuator_effect"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it acts from."""
    share: tuple[Share, Share, Share]
    """[-] B, of the torque about each axis: 1 is sound, 0 is dead."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ActuatorLag:
    """Slower or faster actuators."""

    kind: Literal["actuator_lag"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it acts from."""
    lag_s: Annotated[float, Field(ge=1e-3, allow_inf_nan=False)]
    """[s] time constant."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ActuatorLimit:
    """Weaker actuators: more is not given, whatever is asked; what 1.0 of a command means stays."""

    kind: Literal["actuator_limit"]
    """Names this event."""
    at_s: Time
    """[s] time of the first sample that it acts from."""
    torque_limit_nm: PositiveVector
    """[N*m] B, largest torque about each axis, where it is below the vehicle's own."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Payload:
    """Something is taken up or dropped at the centre of mass, which stays where it is; this event adds to the last."""

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
