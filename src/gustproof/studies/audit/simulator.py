"""Interface through which a simulator is audited.

An adapter turns a simulator's own frames and units into ours and leaves its physics alone. It overrides the methods
that its simulator can serve. The others raise `NotReachable`, and the audit says so instead of passing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.vehicle import GRAVITY
from firmware_model.config.waveforms import Dryden
from firmware_model.types import Quaternion, Vector

Array = NDArray[np.float64]
HEIGHT = 5.0
"""[m] above ground, of the air that an audit asks for."""


class NotReachable(Exception):
    """A quantity that a simulator's interface can neither set nor tell; the text says why."""


@dataclass(frozen=True, kw_only=True)
class Airframe:
    """Vehicle as its simulator states it, in our frames."""

    mass: float
    """[kg]."""
    inertia_B: Vector
    """[kg*m^2] B, principal moments of inertia."""
    position_B: tuple[Vector, ...]
    """[m] B, hubs of the rotors from the centre of mass."""
    spin: tuple[int, ...]
    """[-] 1 counter-clockwise seen from above (drag turns the nose right), -1 clockwise."""
    drag_ratio: float
    """[m] drag torque per thrust of a rotor."""
    thrust_max: float
    """[N] of one rotor at a command of 1."""
    thrust_square: float
    """[-] part s of the thrust that goes with the square of the command: `T / thrust_max = (1 - s) u + s u^2`."""
    actuator_lag: float
    """[s] time constant of a rotor."""

    @property
    def wrench(self) -> Array:
        """(4, n) roll, pitch, yaw torque [N*m] and thrust [N] per thrust [N] of each rotor."""
        x, y, _ = np.array(self.position_B).T
        return np.array([-y, x, self.drag_ratio * np.array(self.spin), np.ones(len(x))])

    def thrusts(self, rotors: Array) -> Array:
        """Return the thrusts (n,) [N] of settled rotors under commands [0..1]."""
        return self.thrust_max * ((1.0 - self.thrust_square) * rotors + self.thrust_square * rotors**2)

    def hover(self) -> Array:
        """Return the commands (n,) [0..1] of a level hover in calm air."""
        share = np.linalg.pinv(self.wrench) @ (0.0, 0.0, 0.0, self.mass * GRAVITY) / self.thrust_max
        s = self.thrust_square
        # The root of s u^2 + (1 - s) u = share, in the form that holds for s = 0 too.
        return np.asarray(2.0 * share / ((1.0 - s) + np.sqrt((1.0 - s) ** 2 + 4.0 * s * share)))


class RequestedAir(NamedTuple):
    """Air that a simulator is asked for; still by default."""

    wind_N: Vector = (0.0, 0.0, 0.0)
    """[m/s] N, mean wind, blowing toward."""
    turbulence: Dryden | None = None
    """Continuous gusts at `HEIGHT`, along and across the mean wind, which is toward north then."""


STILL = RequestedAir()
"""Calm air."""


class FlightStart(NamedTuple):
    """Start of a free flight: level, heading north, without velocity, far from the ground."""

    rotors: Array
    """(n,) [0..1] commands under which the rotors have settled."""
    omega_B: Vector = (0.0, 0.0, 0.0)
    """[rad/s] B."""


class TrueMotion(NamedTuple):
    """True motion of the vehicle."""

    velocity_N: Vector
    """[m/s] N."""
    q_NB: Quaternion
    """Attitude, B to N, scalar first."""
    omega_B: Vector
    """[rad/s] B."""


class Simulator:
    """Simulator to be audited; an adapter overrides what it can serve."""

    name = "unnamed"
    """Name and version, as the table shows them."""

    @property
    def airframe(self) -> Airframe:
        """The vehicle as the simulator states it."""
        raise NotReachable("it does not state its vehicle")

    def reset(self, seed: int, dt: float, air: RequestedAir, start: FlightStart) -> TrueMotion:
        """Begin a free flight in steps of `dt` [s], with every random number drawn from `seed`."""
        raise NotReachable("rotors cannot be commanded one by one from a chosen state")

    def step(self, rotors: Array) -> TrueMotion:
        """Fly a step under commands (n,) [0..1] of the rotors."""
        raise NotReachable("rotors cannot be commanded one by one")

    def fly(
        self, seed: int, dt: float, air: RequestedAir, start: FlightStart, rotors: Array, duration: float
    ) -> list[TrueMotion]:
        """Return the motions of a free flight of `duration` [s] under constant commands, the start first."""
        begin = self.reset(seed, dt, air, start)
        return [begin, *(self.step(rotors) for _ in range(round(duration / dt)))]

    def hover(self, seed: int, dt: float, air: RequestedAir, duration: float) -> list[TrueMotion]:
        """Return the motions of a hover of `duration` [s]; by default the rotors keep their hover commands."""
        rotors = self.airframe.hover()
        return self.fly(seed, dt, air, FlightStart(rotors), rotors, duration)

    def level_flight(self, seed: int, dt: float, air: RequestedAir, duration: float) -> tuple[float, list[TrueMotion]]:
        """Return motions of a level flight by its own autopilot, which leaves the place free, and their period [s]."""
        raise NotReachable("it does not tell the wind at the vehicle")

    def close(self) -> None:
        """End everything that the audit has started."""

    def sample_air(self, seed: int, dt: float, air: RequestedAir, samples: int) -> Array:
        """Return the velocity (samples, 3) [m/s] N of the air at a vehicle that stays at its place."""
        raise NotReachable("it does not tell the wind at the vehicle")


def to_vector(values: Sequence[float] | Array) -> Vector:
    """Return three numbers as a vector of floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z
