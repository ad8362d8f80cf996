"""Rate damping: the number of the vehicle file, or that of its rotors' drag."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.files import read_document, validate
from firmware_model.config.vehicle import Vehicle, load_vehicle, vehicle_path
from firmware_model.errors import ConfigError
from firmware_model.physics.aerodynamics import air_params

PAPER, IRIS = load_vehicle("paper"), load_vehicle("iris")


def uneven() -> Vehicle:
    """Return a hand-made vehicle: arms of 1 and 2 m along x, of 3 m along y, 0.5 m above the centre of mass."""
    hubs = ((1.0, 3.0, -0.5), (-2.0, -3.0, -0.5), (1.0, -3.0, -0.5), (-2.0, 3.0, -0.5))
    return replace(
        PAPER,
        rate_damping=None,
        rotors=replace(PAPER.rotors, position_B=hubs),
        inertia_B=(2.0, 4.0, 5.0),
        heave_drag=0.8,
        gust_gain=0.3,
    )


def drag_moment(vehicle: Vehicle, omega_B: np.ndarray) -> np.ndarray:
    """Return the moment [N*m] B of the rotors' drag, rotor by rotor, with the hubs moved into the plane of z = 0."""
    air, moment = air_params(vehicle), np.zeros(3)
    for x, y, _ in vehicle.rotors.position_B:
        hub = np.array([x, y, 0.0])
        drag = np.array([air.rotor_drag, air.rotor_drag, air.heave_drag]) / 4.0
        moment += np.cross(hub, -drag * np.cross(omega_B, hub))
    return moment


@pytest.mark.parametrize("vehicle", [IRIS, uneven(), replace(PAPER, rate_damping=None)], ids=["iris", "own", "paper"])
def test_the_derived_damping_is_that_of_each_rotors_drag(vehicle):
    for axis, damping in enumerate(vehicle.rate_damping_B):
        rate = np.eye(3)[axis]
        assert -drag_moment(vehicle, rate)[axis] / vehicle.inertia_B[axis] == pytest.approx(damping, rel=1e-12)


def test_the_derived_damping_has_these_values():
    assert uneven().rate_damping_B == pytest.approx((0.8 * 9.0 / 2.0, 0.8 * 2.5 / 4.0, 0.6 * 11.5 / 5.0), rel=1e-12)
    assert IRIS.rate_damping is None
    assert IRIS.rate_damping_B == pytest.approx((0.845, 0.323, 0.616), abs=1e-3)
    assert replace(PAPER, rate_damping=None).rate_damping_B == pytest.approx((0.290, 0.363, 1.477), abs=1e-3)


def test_a_number_in_the_file_holds_about_all_axes():
    assert PAPER.rate_damping_B == (0.02, 0.02, 0.02)
    assert replace(IRIS, rate_damping=0.0).rate_damping_B == (0.0, 0.0, 0.0)


def test_a_derived_moment_is_shared_by_more_inertia():
    heavy = replace(IRIS, inertia_B=tuple(2.0 * value for value in IRIS.inertia_B))
    assert heavy.rate_damping_B == pytest.approx(tuple(0.5 * value for value in IRIS.rate_damping_B), rel=1e-12)


def test_a_file_without_rotors_is_refused():
    """So a damping can always be derived."""
    document = {"name": "bare", **read_document(vehicle_path("iris"))}
    del document["rotors"]
    with pytest.raises(ConfigError, match="rotors"):
        validate(Vehicle, document, "bare.toml")


@pytest.mark.parametrize("key", ["mass", "span", "gust_gain"])
def test_true_is_no_number(key):
    """It would count as 1."""
    with pytest.raises(ConfigError, match=f"{key}: must be a number, not true or false"):
        validate(Vehicle, {"name": "flag", **read_document(vehicle_path("iris")), key: True}, "flag.toml")
