"""Rate damping: the number of the vehicle file, or that of its rotors' drag."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.files import read_document, validate
from firmware_model.config.spreads import take_nominal
from firmware_model.config.units import check_units
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


def test_true_is_no_spin():
    document = read_document(vehicle_path("iris"))
    rotors = {**document["rotors"], "spin": [True, 1, -1, -1]}
    with pytest.raises(ConfigError, match=r"rotors.spin.0: must be a number, not true or false"):
        validate(Vehicle, {"name": "flag", **take_nominal({**document, "rotors": rotors}, "flag.toml")}, "flag.toml")


@pytest.mark.parametrize(
    ("key", "given", "other"),
    [
        ("span", "span = 0.71 ", "span = 710.0 "),
        ("span", "span = 0.71 ", "span = 1e308 "),
        ("torque_limit.0", "torque_limit = [1.5, 0.9, 0.35]", "torque_limit = [1500.0, 900.0, 350.0]"),
        ("torque_limit.2", "torque_limit = [1.5, 0.9, 0.35]", "torque_limit = [1.5, 0.9, 350.0]"),
        ("stabilizer.rate_limit", "rate_limit = 3.8", "rate_limit = 220.0"),
        ("gyro.range", "range = 34.9 ", "range = 2000.0 "),
        ("rotors.thrust_max", "thrust_max = 7.0664", "thrust_max = 720.0"),
        ("rotors.position_B", "[[0.13, 0.22, -0.023], [-0.13, -0.2,", "[[0.13, 0.22, -0.023], [-130, -200,"),
        ("rotors.drag_ratio", "drag_ratio = 0.06 ", "drag_ratio = 60.0 "),
        ("rotors.position_B", "-0.023], [-0.13", "-23.0], [-0.13"),
        ("gear.height", "height = ", "height = 1e3 # "),
        ("gear.sag", "sag = ", "sag = 5.0 # "),
        ("drag_area", "drag_area = ", "drag_area = 100.0 # "),
        ("position.xy_velocity_max", "xy_velocity_max = ", "xy_velocity_max = 1200.0 # "),
        ("actuator_lag", "{ nominal = 0.025, low = 0.0175, high = 0.0325 }", "25.0"),
        ("inertia_B", "inertia_B = [", "inertia_B = [291.25, 291.25, 552.25]\n[x]\ny = ["),
    ],
)
def test_a_number_in_another_unit_is_refused_by_its_key(tmp_path, key, given, other):
    """Most flew without a word: torque in N mm, rates in deg/s, thrust in gram, span in mm."""
    text = vehicle_path("iris").read_text(encoding="utf-8")
    assert given in text
    file = tmp_path / "mixed.toml"
    text = text.replace(given, other)
    if "[x]" in text:
        begin = text.index("[x]")
        text = text[:begin] + text[text.index("actuator_lag") :]
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"mixed\.toml: {key}: .* is beyond .*: see its unit"):
        load_vehicle(file)


@pytest.mark.parametrize(("scale", "mass"), [(0.25, 0.02), (5.0, 200.0)])
def test_vehicles_of_20_g_and_200_kg_have_sound_units(tmp_path, scale, mass):
    heavier = mass / IRIS.mass
    arms = [[scale * each for each in place] for place in IRIS.rotors.position_B]
    document = {**read_document(vehicle_path("iris")), "mass": mass, "span": scale * IRIS.span, "actuator_lag": 0.03}
    document["inertia_B"] = [heavier * scale**2 * each for each in IRIS.inertia_B]
    document["torque_limit"] = [heavier * scale * each for each in IRIS.torque_limit]
    document["rotors"] = {**document["rotors"], "position_B": arms, "thrust_max": heavier * IRIS.rotors.thrust_max}
    vehicle = validate(Vehicle, {"name": "scaled", **take_nominal(document, "scaled.toml")}, "scaled.toml")
    check_units(vehicle, "scaled.toml")
