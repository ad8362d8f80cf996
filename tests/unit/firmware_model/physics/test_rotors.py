"""Torques and thrust shared out among rotors, judged by r x F and by linear programming."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.numerics.compiled import compiled
from firmware_model.numerics.soa import flatten, single
from firmware_model.physics.rotors import allocate, can_give, can_hover, put_rotor_thrusts, rotor_params

HEXAGON = np.radians((30, 90, 150, 210, 270, 330))
HUBS = tuple((0.5 * math.cos(angle), 0.5 * math.sin(angle), -0.05) for angle in HEXAGON)


def hexa(spin: tuple[int, ...]) -> Vehicle:
    """A hexarotor, its rotors in clockwise order."""
    paper = load_vehicle("paper")
    return replace(paper, name="hexa", rotors=replace(paper.rotors, position_B=HUBS, spin=spin))


QUADS = {name: load_vehicle(name) for name in ("paper", "iris")}
VEHICLES = {**QUADS, "octo": load_vehicle("octo"), "hexa": hexa((1, 1, -1, -1, 1, -1))}
SHARE = st.floats(-1.5, 1.5)


@compiled
def _flown(params, count, torque_B, thrust, rotors):
    given_torque, given_thrust = allocate(single(params), 0, count, torque_B, thrust)
    if can_give(single(params), 0, count, torque_B, thrust) and (given_torque, given_thrust) != (torque_B, thrust):
        given_thrust = np.nan  # it must give all of such a demand, to the bit
    put_rotor_thrusts(single(params), 0, count, given_torque, given_thrust, single(rotors), 0)
    return given_torque, given_thrust


def flown(name: str, torque_B, thrust: float) -> tuple[np.ndarray, float, np.ndarray]:
    geometry = VEHICLES[name].rotors
    params, rotors = np.array([*flatten(rotor_params(geometry))]), np.zeros(geometry.count)
    torque, thrust = _flown(params, geometry.count, tuple(map(float, torque_B)), float(thrust), rotors)
    return np.array(torque), thrust, rotors


def effect(vehicle: Vehicle) -> np.ndarray:
    """Wrench (roll, pitch, yaw, thrust) per rotor thrust, from r x F and the drag against the rotor's turning."""
    arms = np.cross(vehicle.rotors.position_B, (0.0, 0.0, -1.0))
    arms[:, 2] += vehicle.rotors.drag_ratio * np.array(vehicle.rotors.spin)
    return np.vstack([arms.T, np.ones(len(arms))])


@pytest.mark.slow
@pytest.mark.parametrize("name", VEHICLES)
@given(shares=st.tuples(SHARE, SHARE, SHARE), throttle=st.floats(-0.2, 1.2))
@settings(max_examples=200)
def test_what_is_given_is_what_the_rotors_make_and_no_rotor_leaves_its_range(name, shares, throttle):
    vehicle = VEHICLES[name]
    most = vehicle.rotors.thrust_max
    torque, thrust, rotors = flown(
        name, np.array(shares) * vehicle.torque_limit, throttle * len(vehicle.rotors.spin) * most
    )
    np.testing.assert_allclose(effect(vehicle) @ rotors, [*torque, thrust], atol=1e-11 * most)
    assert rotors.min() >= -1e-12 * most
    assert rotors.max() <= (1.0 + 1e-12) * most


@pytest.mark.slow
@pytest.mark.parametrize("name", QUADS)
@given(rotors=st.tuples(*[st.floats(0.0, 1.0)] * 4))
@settings(max_examples=200)
def test_what_the_rotors_can_give_with_and_without_yaw_is_given_in_full(name, rotors):
    vehicle = VEHICLES[name]
    asked = effect(vehicle) @ rotors * vehicle.rotors.thrust_max
    without_yaw = np.linalg.solve(effect(vehicle), asked * (1.0, 1.0, 0.0, 1.0)) / vehicle.rotors.thrust_max
    assume(without_yaw.min() >= 0.0)
    assume(without_yaw.max() <= 1.0)
    torque, thrust, _ = flown(name, asked[:3], asked[3])
    np.testing.assert_allclose([*torque, thrust], asked, atol=1e-11 * vehicle.rotors.thrust_max)


@pytest.mark.parametrize("name", VEHICLES)
def test_at_the_limits_tilt_comes_before_thrust_and_thrust_before_yaw(name):
    """Each stage against the linear program that asks for the same, lexicographically."""
    vehicle = VEHICLES[name]
    most, rng = vehicle.rotors.thrust_max, np.random.default_rng(3)
    share, n = np.linalg.pinv(effect(vehicle)), vehicle.rotors.count
    saturated = 0
    for _ in range(60):
        asked = np.array([*rng.uniform(-6.0, 6.0, 3) * vehicle.torque_limit, rng.uniform(-0.2, 1.2) * n * most])
        torque, thrust, _ = flown(name, asked[:3], asked[3])
        tilt, turn = share[:, :2] @ asked[:2], share[:, 2] * asked[2]
        # Largest s in 0..1 for which some thrust F keeps s tilt + F share within 0..most.
        both = np.column_stack([tilt, share[:, 3]])
        room = [*[most] * n, *[0.0] * n]
        best = linprog([-1.0, 0.0], np.vstack([both, -both]), room, bounds=[(0.0, 1.0), (None, None)])
        s = best.x[0]
        np.testing.assert_allclose(torque[:2], s * asked[:2], atol=1e-7 * most)
        # Thrust nearest to what is asked.
        lifts = -s * tilt / share[:, 3], (most - s * tilt) / share[:, 3]
        assert thrust == pytest.approx(min(max(asked[3], lifts[0].max()), lifts[1].min()), abs=1e-7 * most)
        # Largest part of the yaw that then fits.
        used = s * tilt + share[:, 3] * thrust
        fits = [(most - u) / t if t > 0.0 else -u / t for u, t in zip(used, turn, strict=True)]
        assert torque[2] == pytest.approx(np.clip(min(fits), 0.0, 1.0) * asked[2], abs=1e-6 * most)
        saturated += s < 1.0
    assert 10 < saturated < 60


def test_signs_by_hand_in_px4s_order_of_rotors():
    """1 front right, 2 rear left, both counter-clockwise; 3 front left, 4 rear right, both clockwise."""
    weight = 98.0
    hover = np.full(4, weight / 4.0)
    right_down, nose_up, nose_right = (flown("paper", torque, weight)[2] - hover for torque in np.eye(3))
    assert (np.sign(right_down) == (-1, 1, 1, -1)).all()  # the left ones lift
    assert (np.sign(nose_up) == (1, -1, 1, -1)).all()  # the front ones lift
    assert (np.sign(nose_right) == (1, 1, -1, -1)).all()  # against those that turn left


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"spin": (1, 1, 1, 1)}, "independently: check spin"),
        ({"spin": (1, -1, 1, -1)}, "independently: check spin"),  # both front ones turn left: yaw is pitch then
        ({"spin": (1, 1, -1)}, "3 of them, for 4 rotors"),
        ({"spin": (1, 1, -1, -1, 1)}, "5 of them, for 4 rotors"),
        ({"position_B": HUBS[:3], "spin": (1, -1, 1)}, "at least 4"),
        ({"position_B": ((0.2, 0.1, -0.1), (0.1, -0.2, -0.1), (0.2, -0.1, -0.1), (0.1, 0.2, -0.1))}, "not between"),
    ],
)
def test_a_geometry_that_cannot_fly_is_refused(change, cause):
    with pytest.raises(ValueError, match=cause):
        replace(VEHICLES["paper"].rotors, **change)


@pytest.mark.parametrize(
    ("vehicle", "survived"),
    [
        (VEHICLES["paper"], ()),
        (VEHICLES["octo"], range(8)),
        (hexa((1, -1, 1, -1, 1, -1)), ()),
        (hexa((1, 1, -1, -1, 1, -1)), range(4)),
    ],
    ids=["quad", "octo", "hexa-PNPNPN", "hexa-PPNNPN"],
)
def test_who_survives_the_loss_of_which_rotor(vehicle, survived):
    """As in G.-X. Du, Q. Quan, B. Yang, K.-Y. Cai, Controllability analysis for multirotor helicopter rotor degradation
    and failure, Journal of Guidance, Control, and Dynamics 38, 2015: PNPNPN with no rotor, PPNNPN with some."""
    rotors = replace(vehicle.rotors, thrust_max=10.0 * vehicle.mass)
    lost = [tuple(float(k != i) for k in range(rotors.count)) for i in range(rotors.count)]
    assert [i for i, health in enumerate(lost) if can_hover(rotors, health, 9.81 * vehicle.mass)] == [*survived]
    assert can_hover(rotors, (1.0,) * rotors.count, 9.81 * vehicle.mass)
