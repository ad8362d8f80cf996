"""INDI with rotor speeds: increments of rotor speed for the missing angular acceleration.

    nu  = rate_p (s - omega),      s = angle_p e,
    tau = tau_f + J (nu - domega_f),
    w_c = w + G(w)^-1 (tau - tau(w), weight - thrust(w))

`domega_f` is the derivative of the low-passed gyro. `tau_f` is the torque of the rotor speeds `w` behind the same
filter, so both refer to the same instant and their difference is the disturbance alone. `G` is the effectiveness of
rotor speeds. Thrust is quadratic in speed, so a slow rotor gives less for the same change. Its inverse is the
vehicle's allocation, which is of least squares beyond four rotors. `e` is axis times angle to the reference.

Differences from the publication. Rotor speeds are not measured here: no entry gets telemetry. They come from a model of
first-order actuators, fed with the speeds that the law itself commands, a sample late as they act. Axes have filters of
their own, so torques of the speeds are filtered instead of the speeds. The collective thrust is not the law's; its
model holds the weight. Torques of the rotors' own inertia (G_2) are left out, as vehicle files don't have it.
Effectiveness is the vehicle file's and doesn't adapt. The answer is the torque of the commanded speeds. The commanded
rate is shortened to the rate limit that all laws here have.

References
----------
E. J. J. Smeur, Q. Chu, G. C. H. E. de Croon, Adaptive incremental nonlinear dynamic inversion for attitude control of
micro air vehicles, Journal of Guidance, Control, and Dynamics 39 (2016), 450-461.
"""

import math
from collections.abc import Iterable, Sequence

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.types import Vector
from gustproof.design.cascades.indi import IndiGains, low_pass
from gustproof.guide.examples.rotations import HeldAttitude, as_vector, pick_gains, rotation_vector, shorten

_SLOWEST = 0.05
"""[-] of the largest speed: rotors are not commanded below it, as their effectiveness ends there."""
_TUNED = {
    "paper": (
        (3.8877211958846245, 14.303960926254108, 25.468117517612036, 0.17626127520080537),
        (3.901450905754106, 14.491451925720355, 27.851118618193098, 0.15558146747169604),
        (2.73476309392027, 15.976960803647072, 30.916720275160397, 0.13301413186057737),
    ),
    "iris": (
        (4.39525206756379, 24.271946891744026, 48.15228664142171, 0.17458158421290498),
        (7.463429493161589, 20.854710620457958, 40.89156009731055, 0.24755069556264506),
        (0.8252264773193492, 21.46394849976342, 36.75149721354933, 0.34236034395050774),
    ),
}
"""Gains as `IndiGains` names them, tuned in turbulence."""


class _Axis:
    """Gains and synchronised filters of one axis."""

    def __init__(self, gains: IndiGains, inertia: float, dt: float) -> None:
        filtered = low_pass(gains, dt)
        (c1, c2), (d1, d2) = filtered.C.tolist(), filtered.D[:, 0].tolist()
        (a1, a2), (b1, b2) = filtered.A.tolist(), filtered.B[:, 0].tolist()
        # of two states and the input: to the low-passed signal, to its derivative, and to the next states
        self._value: Vector = (*c1, d1)
        self._slope: Vector = (*c2, d2)
        self._next: tuple[Vector, Vector] = ((*a1, b1), (*a2, b2))
        self._rate_p, self._inertia = gains.rate_p, inertia
        self._gyro = self._torque = (0.0, 0.0)

    def torque(self, rate: float, commanded: float, present: float) -> float:
        """Return the torque [N*m] for the commanded rate [rad/s], from the gyro and the present torque [N*m]."""
        (g1, g2), (t1, t2) = self._gyro, self._torque
        v1, v2, v3 = self._value
        s1, s2, s3 = self._slope
        (a, b, c), (d, e, f) = self._next
        self._gyro = a * g1 + b * g2 + c * rate, d * g1 + e * g2 + f * rate
        self._torque = a * t1 + b * t2 + c * present, d * t1 + e * t2 + f * present
        missing = self._rate_p * (commanded - rate) - (s1 * g1 + s2 * g2 + s3 * rate)
        return v1 * t1 + v2 * t2 + v3 * present + self._inertia * missing


class RotorIndi:
    """The law in flight, from hover at rest."""

    def __init__(self, vehicle: Vehicle, gains: Sequence[IndiGains]) -> None:
        self._vehicle, self._gains = vehicle, tuple(gains)
        rotors, weight = vehicle.rotors, vehicle.mass * GRAVITY
        self._rate_limit, self._limit = vehicle.stabilizer.rate_limit, vehicle.torque_limit
        # thrusts in units of a rotor's largest, which is that of speed 1
        self._roll, self._pitch, self._yaw = (rotors.thrust_max * rotors.wrench[:3]).tolist()
        self._share: list[list[float]] = (rotors.allocation[:, :3] / rotors.thrust_max).tolist()
        self._rest: list[float] = (rotors.allocation[:, 3] * weight / rotors.thrust_max).tolist()
        self._attitude = HeldAttitude()
        self.reset()

    def reset(self) -> None:
        """Return to hover, at rest."""
        self._attitude.reset()
        self._dt = 0.0
        self._speed = self._sent = [math.sqrt(thrust) for thrust in self._rest]

    def _start(self, dt: float) -> None:
        """Make the filters for a sample time [s]."""
        self._dt, self._keep = dt, math.exp(-dt / self._vehicle.actuator_lag)
        self._axes = [_Axis(g, J, dt) for g, J in zip(self._gains, self._vehicle.inertia_B, strict=True)]

    def step(self, gyro: Iterable[float], reference: Iterable[float], force: Iterable[float], dt: float) -> Vector:
        """Return the torque [N*m] B for a gyro sample [rad/s]; the specific force is not read."""
        if dt != self._dt:
            self._start(dt)
        rates = as_vector(gyro)
        e = rotation_vector(*self._attitude.update(rates, as_vector(reference), dt))
        g1, g2, g3 = self._gains
        s = shorten((-g1.angle_p * e[0], -g2.angle_p * e[1], -g3.angle_p * e[2]), self._rate_limit)
        present = self._torques(self._speed)
        torques = [axis.torque(*of) for axis, *of in zip(self._axes, rates, s, present, strict=True)]
        L, M, N = (min(max(u, -limit), limit) for u, limit in zip(torques, self._limit, strict=True))
        commanded = []
        for w, (roll, pitch, yaw), rest in zip(self._speed, self._share, self._rest, strict=True):
            thrust = rest + roll * L + pitch * M + yaw * N
            commanded.append(min(max(w + 0.5 * (thrust - w * w) / w, _SLOWEST), 1.0))
        keep = self._keep
        self._speed = [keep * w + (1.0 - keep) * sent for w, sent in zip(self._speed, self._sent, strict=True)]
        self._sent = commanded
        x, y, z = self._torques(commanded)  # of second order beyond the increment, so limited once more
        L, M, N = self._limit
        return min(max(x, -L), L), min(max(y, -M), M), min(max(z, -N), N)

    def _torques(self, speeds: list[float]) -> Vector:
        """Return the torque [N*m] B of rotor speeds (n,) [-], in units of the largest."""
        L = M = N = 0.0
        for w, roll, pitch, yaw in zip(speeds, self._roll, self._pitch, self._yaw, strict=True):
            thrust = w * w
            L += roll * thrust
            M += pitch * thrust
            N += yaw * thrust
        return L, M, N


def make(vehicle: Vehicle) -> RotorIndi:
    """Return the law for a vehicle."""
    names = ("angle_p", "rate_p", "cutoff", "damping")
    rows = (dict(zip(names, each, strict=True)) for each in pick_gains(_TUNED, vehicle))
    return RotorIndi(vehicle, [IndiGains(**row) for row in rows])
