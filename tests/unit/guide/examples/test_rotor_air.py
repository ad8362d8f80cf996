"""Response to moving air, beside blade elements summed over radius and azimuth in a linear field of wind."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.vehicle import GRAVITY, load_vehicle, vehicle_path
from firmware_model.physics.aerodynamics import AIR_DENSITY
from gustproof.guide.examples.rotor_air import (
    TEN_INCH,
    Blades,
    format_lines,
    hover_state,
    rotor_response,
    vehicle_response,
)

IRIS = load_vehicle("iris")
HUBS = [(sign_x * 0.13, sign_y * 0.21, -0.1) for sign_x, sign_y in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
SYMMETRIC = replace(IRIS, rotors=replace(IRIS.rotors, position_B=tuple(HUBS)))
BROAD = Blades(radius=0.19, chord=0.035, count=3, tip_speed=70.0, lift_slope=5.0, drag=0.03, root=0.2)
STILL, CALM = np.zeros(3), np.zeros((3, 3))


def strip_theory(vehicle, blades, wind, field):
    """Return force [N] and moment [N*m] B on all rotors in air of `wind` [m/s] plus `field` (3, 3) [1/s] times place.

    Inflow at each element of a disc: its thrust equals its momentum, 2 rho (induced) |all air|, after Glauert.
    """
    _, pitch = hover_state(blades, vehicle.mass * GRAVITY / vehicle.rotors.count)
    points, weights = np.polynomial.legendre.leggauss(24)
    x = (0.5 * (1.0 - blades.root) * (points + 1.0) + blades.root)[:, None]
    angle = np.arange(24) * 2.0 * np.pi / 24
    across = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    share = 0.5 * (1.0 - blades.root) * weights[:, None] / 24
    unit = AIR_DENSITY * np.pi * blades.radius**2 * blades.tip_speed**2
    force, moment = np.zeros(3), np.zeros(3)
    for hub, spin in zip(vehicle.rotors.position_B, vehicle.rotors.spin, strict=True):
        along = -spin * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle])
        place = np.array(hub)[:, None, None] + blades.radius * x * across[:, None, :]
        air = (np.array(wind)[:, None, None] + np.einsum("ij,jkl->ikl", field, place)) / blades.tip_speed
        tangential = x - np.einsum("ijk,ik->jk", air, along)
        edge = air[0] ** 2 + air[1] ** 2
        induced = np.full(tangential.shape, 0.05)
        for _ in range(60):  # Newton's method
            through = induced + air[2]
            speed = np.sqrt(edge + through**2)
            loading = 0.5 * blades.lift_solidity * (pitch / x * tangential**2 - through * tangential)
            slope = -0.5 * blades.lift_solidity * tangential - 4.0 * x * (speed + induced * through / speed)
            induced = induced - (loading - 4.0 * x * induced * speed) / slope
        through = induced + air[2]
        lift = pitch / x * tangential**2 - through * tangential
        held = pitch / x * tangential * through - through**2
        dragged = 0.5 * blades.solidity * (blades.lift_slope * held + blades.drag * tangential**2)
        each = -dragged[None] * along[:, None, :]
        each[2] = -0.5 * blades.lift_solidity * lift
        each *= unit * share
        force += each.sum(axis=(1, 2))
        moment += np.cross(place, each, axis=0).sum(axis=(1, 2))
    return force, moment


def slope(vehicle, blades, wind, field, mean=STILL):
    """Return force and moment (6,) per unit of a wind or field, by central differences about a `mean` wind."""
    ends = [np.hstack(strip_theory(vehicle, blades, mean + h * wind, h * field)) for h in (1e-3, -1e-3)]
    return (ends[0] - ends[1]) / 2e-3


def turn(axis):
    return np.cross(np.eye(3)[axis], np.eye(3)).T


@pytest.mark.parametrize("case", [(SYMMETRIC, TEN_INCH), (load_vehicle("paper"), BROAD)], ids=["iris", "paper"])
def test_the_closed_forms_are_the_linear_part_of_all_blade_elements(case) -> None:
    vehicle, blades = case
    weight = vehicle.mass * GRAVITY
    assert -strip_theory(vehicle, blades, STILL, CALM)[0][2] == pytest.approx(weight, rel=1e-9)
    found, each = vehicle_response(vehicle, blades), rotor_response(blades, weight / 4)
    gain = found.gust_gain
    expected = np.zeros((6, 6))
    expected[:3, :3] = np.diag([4.0 * each.drag, 4.0 * each.drag, found.heave_drag])
    # As `gust_moment` has it, without yaw; and air that turns passes the rotor plane, at its height.
    expected[3, 1], expected[4, 0], expected[1, 3], expected[0, 4] = gain, -gain, gain, -gain
    expected[3:, 3:] = np.diag(np.multiply(found.rate_damping, vehicle.inertia_B))
    winds = [slope(vehicle, blades, axis, CALM) for axis in np.eye(3)]
    turns = [slope(vehicle, blades, STILL, turn(axis)) for axis in range(3)]
    np.testing.assert_allclose(np.transpose([*winds, *turns]), expected, rtol=1e-5, atol=1e-7)
    # A field that only shears: w over y rolls as much but for the height, v over x yaws by its arms along x alone.
    x, y, _ = vehicle.rotors.position_B[0]
    forward, right, down = np.eye(3)
    shear_w, shear_v = (slope(vehicle, blades, STILL, np.outer(*axes)) for axes in ((down, right), (right, forward)))
    assert shear_w[3] == pytest.approx(4.0 * (each.heave * y * y + each.roll), rel=1e-5)
    assert shear_v[5] == pytest.approx(4.0 * (each.drag * x * x + each.yaw / 2.0), rel=1e-5)


@pytest.mark.parametrize(("speed", "moment", "damping"), [(5.0, 1.010, 1.31), (10.0, 1.033, 1.83), (15.0, 1.011, 2.16)])
def test_what_the_guide_says_is_left_beside_the_linear_part_in_wind(speed, moment, damping) -> None:
    blown, wind = np.array((speed, 0.0, 0.0)), (SYMMETRIC, TEN_INCH)
    linear = vehicle_response(*wind)
    assert strip_theory(*wind, blown, CALM)[1][1] / (-linear.gust_gain * speed) == pytest.approx(moment, abs=6e-4)
    in_wind = slope(*wind, STILL, turn(0), blown)[3] / IRIS.inertia_B[0]
    assert in_wind / linear.rate_damping[0] == pytest.approx(damping, rel=0.01)


def test_without_root_the_heave_is_the_formula_of_hovering_helicopters() -> None:
    blades = replace(TEN_INCH, root=1e-9)
    inflow, _ = hover_state(blades, 3.7)
    size, area = blades.lift_solidity, np.pi * blades.radius**2
    classic = AIR_DENSITY * area * blades.tip_speed * 2.0 * inflow * size / (16.0 * inflow + size)
    assert rotor_response(blades, 3.7).heave == pytest.approx(classic, rel=1e-12)


def test_lines_for_a_vehicle_file_say_that_they_are_derived(tmp_path) -> None:
    lines = format_lines(vehicle_response(IRIS, TEN_INCH), TEN_INCH)
    assert lines.count("derived from blades: R 0.127 m") == 4
    text = vehicle_path("iris").read_text()
    names = [line.split(" = ")[0] for line in lines.splitlines()]
    kept = "\n".join(line for line in text.splitlines() if line.split(" = ")[0] not in names)
    (tmp_path / "mine.toml").write_text(kept.replace("[rotors]", lines + "[rotors]"))
    vehicle = load_vehicle(tmp_path / "mine.toml")
    assert vehicle.gust_gain == pytest.approx(0.000994, rel=1e-3)
    assert vehicle.rate_damping_B == pytest.approx(vehicle_response(IRIS, TEN_INCH).rate_damping, rel=1e-3)
