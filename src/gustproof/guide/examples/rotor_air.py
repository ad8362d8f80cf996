"""Derive a vehicle's response to moving air from its blades: `python rotor_air.py VEHICLE`, for blades as `TEN_INCH`.

It prints lines for a vehicle file, marked as derived. A measured number is better where there is one. Each element of a
blade has the wind of its own place, and each element of the disc the inflow that its own thrust induces. In hover that
gives closed forms for rigid blades of ideal twist, tip pitch over r / R, which a propeller's constant pitch is.

References
----------
J. G. Leishman, Principles of Helicopter Aerodynamics, 2nd edition, 2006, chapter 3: blade elements, local momentum and
ideal twist in hover.
"""

import math
import sys
from dataclasses import dataclass
from typing import NamedTuple

from firmware_model.config.vehicle import GRAVITY, Vehicle, load_vehicle
from firmware_model.physics.aerodynamics import AIR_DENSITY
from firmware_model.types import Vector


@dataclass(frozen=True, kw_only=True)
class Blades:
    """Rotor of rigid blades."""

    radius: float
    """[m]."""
    chord: float
    """[m] on average over the radius."""
    count: int
    """Blades of a rotor."""
    tip_speed: float
    """[m/s] in hover."""
    lift_slope: float
    """[1/rad] of the section: 2 pi less some 10 to 20 % at low Reynolds numbers."""
    drag: float
    """[-] drag coefficient of the section."""
    root: float
    """[-] of the radius, where the blade begins."""

    @property
    def lift_solidity(self) -> float:
        """[1/rad] lift slope times blade area over disc area."""
        return self.lift_slope * self.solidity

    @property
    def solidity(self) -> float:
        """[-] blade area over disc area."""
        return self.count * self.chord / (math.pi * self.radius)


class HoverState(NamedTuple):
    """Rotor in hover."""

    inflow: float
    """[-] induced speed over tip speed, the same everywhere."""
    tip_pitch: float
    """[rad] pitch at the tip."""


class RotorResponse(NamedTuple):
    """Force and moments of one rotor in hover, at a held speed of rotation, per motion of the air."""

    drag: float
    """[N/(m/s)] in its plane, per speed in the plane."""
    heave: float
    """[N/(m/s)] along its axis, per speed along it."""
    roll: float
    """[N*m/(rad/s)] about its hub, per rotation of the air about an axis in its plane."""
    yaw: float
    """[N*m/(rad/s)] about its axis, per rotation of the air about it."""


class VehicleResponse(NamedTuple):
    """Numbers of a vehicle file."""

    gust_gain: float
    """[N*m/(m/s)]."""
    heave_drag: float
    """[N/(m/s)]."""
    rate_damping: Vector
    """[1/s] B."""


def hover_state(blades: Blades, thrust: float) -> HoverState:
    """Return inflow and pitch of a rotor that gives a `thrust` [N]: lift and momentum agree at each radius."""
    disc = math.pi * blades.radius**2 * (1.0 - blades.root**2)
    inflow = math.sqrt(thrust / (2.0 * AIR_DENSITY * disc)) / blades.tip_speed
    return HoverState(inflow, inflow + 8.0 * inflow**2 / blades.lift_solidity)


def rotor_response(blades: Blades, thrust: float) -> RotorResponse:
    """Return the response of one rotor that hovers at a `thrust` [N].

    Air along the axis changes the flow through the disc by 8 i / (16 i + s a) of itself, with inflow i and
    `lift_solidity` s a. The rest is induced flow that gives way. A tangential speed v changes it by `follows` v R / r.
    The force in the plane is the sections' drag, and the lift that the inflow leans back. Both count for the advancing
    blade less the retreating one.
    """
    (inflow, pitch), size, root = hover_state(blades, thrust), blades.lift_solidity, blades.root
    unit = AIR_DENSITY * math.pi * blades.radius**2 * blades.tip_speed
    heave = unit * 4.0 * inflow * size / (16.0 * inflow + size)
    follows = (2.0 * pitch - inflow) * size / (16.0 * inflow + size)
    leaned = blades.lift_slope * (pitch * inflow + (pitch - 2.0 * inflow) * follows)
    side = unit * blades.solidity / 4.0
    return RotorResponse(
        drag=side * (leaned * math.log(1.0 / root) + blades.drag * (1.0 - root**2)),
        heave=heave * (1.0 - root**2) / 2.0,
        roll=heave * blades.radius**2 * (1.0 - root**4) / 8.0,
        yaw=side * blades.radius**2 * (leaned * (1.0 - root**2) + blades.drag * (1.0 - root**4)),
    )


def vehicle_response(vehicle: Vehicle, blades: Blades) -> VehicleResponse:
    """Return the numbers of a vehicle file for rotors that share the weight; layouts are symmetric.

    Equal rotors that turn both ways give no yaw in a vertical gust, so `gust_yaw_ratio` is 0 by this theory. What a
    vehicle shows is that of its asymmetry. The body's drag is quadratic, and its moment in hover has no linear part.
    """
    rotors, n = vehicle.rotors, vehicle.rotors.count
    drag, heave, roll, yaw = rotor_response(blades, vehicle.mass * GRAVITY / n)
    damping = [0.0, 0.0, 0.0]
    for x, y, z in rotors.position_B:
        damping[0] += heave * y * y + drag * z * z + roll
        damping[1] += heave * x * x + drag * z * z + roll
        damping[2] += drag * (x * x + y * y) + yaw
    p, q, r = (each / inertia for each, inertia in zip(damping, vehicle.inertia_B, strict=True))
    return VehicleResponse(n * drag * rotors.height, n * heave, (p, q, r))


def format_lines(found: VehicleResponse, blades: Blades) -> str:
    """Return lines for a vehicle file, each with its origin."""
    size = f"R {blades.radius:g} m, solidity {blades.solidity:.3g}, tips {blades.tip_speed:g} m/s"
    origin = f"# {{}} derived from blades: {size}"
    gain, heave, (p, q, r) = found
    return (
        f"gust_gain = {gain:.4g}  {origin.format('[N*m/(m/s)]')}\n"
        f"gust_yaw_ratio = 0.0  {origin.format('[-]')}\n"
        f"heave_drag = {heave:.4g}  {origin.format('[N/(m/s)]')}\n"
        f"rate_damping = [{p:.4g}, {q:.4g}, {r:.4g}]  {origin.format('[1/s]')}\n"
    )


TEN_INCH = Blades(radius=0.127, chord=0.02, count=2, tip_speed=100.8, lift_slope=5.5, drag=0.02, root=0.15)
"""Rotor of 10 x 4.7 inch at the 794 rad/s in which `iris` hovers; chord, sections and root are assumed."""

if __name__ == "__main__":
    sys.stdout.write(format_lines(vehicle_response(load_vehicle(sys.argv[1]), TEN_INCH), TEN_INCH))
