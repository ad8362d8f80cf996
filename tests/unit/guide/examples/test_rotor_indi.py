"""INDI with rotor speeds: its increments by hand."""

import numpy as np
import pytest

from firmware_model.config.vehicle import GRAVITY, load_vehicle
from gustproof.design.cascades.indi import IndiGains, low_pass
from gustproof.guide.examples.rotor_indi import RotorIndi

DT, LEVEL = 0.004, (0.0, 0.0, 0.0)
GAINS = IndiGains(angle_p=4.0, rate_p=14.0, cutoff=25.0, damping=0.5)


@pytest.mark.parametrize("name", ["paper", "octo"])
def test_increments_of_rotor_speed_by_hand(name):
    vehicle = load_vehicle(name)
    rotors, J = vehicle.rotors, np.array(vehicle.inertia_B)
    flying, gyro = RotorIndi(vehicle, [GAINS] * 3), np.array([0.3, -0.2, 0.4])
    found = flying.step(gyro, LEVEL, LEVEL, DT)
    nu = 14.0 * (-4.0 * 0.5 * DT * gyro - gyro)
    torque = J * (nu - low_pass(GAINS, DT).D[1, 0] * gyro)
    hover = rotors.allocation[:, 3] * vehicle.mass * GRAVITY
    speed = np.sqrt(hover / rotors.thrust_max)
    effectiveness = rotors.wrench @ np.diag(2.0 * rotors.thrust_max * speed)
    # of all increments that give this wrench to first order, those of least squares in thrust
    change = rotors.allocation @ np.append(torque, 0.0) / (2.0 * rotors.thrust_max * speed)
    assert effectiveness @ change == pytest.approx(np.append(torque, 0.0), abs=1e-9)
    expected = rotors.wrench[:3] @ (rotors.thrust_max * (speed + change) ** 2)
    assert found == pytest.approx(expected, rel=1e-6)


def test_rotors_keep_their_limits_and_yaw_gets_what_they_can_give():
    vehicle = load_vehicle("paper")
    flying = RotorIndi(vehicle, [GAINS] * 3)
    for _ in range(200):
        found = flying.step((0.0, 0.0, -8.0), LEVEL, LEVEL, DT)
        assert all(0.05 <= speed <= 1.0 for speed in flying._sent)
    # two rotors at their largest thrust, two near none: half of all thrust times the drag ratio
    most = 2.0 * vehicle.rotors.thrust_max * vehicle.rotors.drag_ratio
    assert found[2] == pytest.approx(most, rel=0.01)
    assert found[2] < vehicle.torque_limit[2]


def test_a_constant_moment_is_held_without_offset():
    # still gyro: the model's own torque is what holds the moment, and stays
    flying = RotorIndi(load_vehicle("paper"), [GAINS] * 3)
    flying.step((0.05, 0.0, 0.0), LEVEL, LEVEL, DT)
    torques = [flying.step((0.0, 0.0, 0.0), LEVEL, LEVEL, DT)[0] for _ in range(400)]
    rises = np.diff(torques[200:])
    # an attitude error that stays commands a torque that grows: the law integrates
    assert np.all(rises < 0.0)
