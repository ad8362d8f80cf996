import tomllib
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import FullScale, load_vehicle
from firmware_model.errors import ConfigError
from gustproof.logs.identify.identification import Interval
from gustproof.logs.identify.vehicle_file import Known, make_vehicle_file
from gustproof.logs.read.flight_log import CommandUnit

IRIS, PAPER = load_vehicle("iris"), load_vehicle("paper")


def loaded(file, folder):
    """Return the vehicle set of a file, written and read."""
    path = folder / "mine.toml"
    path.write_text(file.text, encoding="utf-8")
    return load_vehicle_set(path)


def without(found, axis):
    """Return an identification that lacks an axis."""
    lost = replace(found.axes[axis], gain=None, damping=None, advice="not excited: fly a chirp")
    return replace(found, axes=tuple(lost if k == axis else each for k, each in enumerate(found.axes)))


def test_torques_in_newton_metres_give_the_inertia_with_its_interval(perfect, tmp_path):
    vehicles = loaded(make_vehicle_file("mine", perfect(PAPER), Known(like="paper")), tmp_path)
    assert vehicles.nominal.inertia_B == pytest.approx(PAPER.inertia_B, rel=1e-4)
    assert vehicles.nominal.actuator_lag == pytest.approx(PAPER.actuator_lag, rel=1e-4)
    assert vehicles.nominal.gyro.noise_density == pytest.approx(PAPER.gyro.noise_density, rel=1e-4)
    assert vehicles.nominal.rate_damping == pytest.approx(PAPER.rate_damping_B, rel=1e-4)
    spread = vehicles.spreads["inertia_B.x"]
    assert (spread.low, spread.high) == pytest.approx((0.25 / 1.05, 0.25 / 0.95), rel=1e-4)
    lag = vehicles.spreads["actuator_lag"]
    assert (lag.low, lag.high) == pytest.approx((0.0475, 0.0525), rel=1e-4)


def test_commands_without_a_unit_give_the_torque_limit_of_an_inertia(perfect, tmp_path):
    found = perfect(IRIS, unit=CommandUnit.NORMALISED)
    file = make_vehicle_file("mine", found, Known(like="iris", inertia_B=(0.03, 0.04, 0.06)))
    vehicles = loaded(file, tmp_path)
    assert vehicles.nominal.inertia_B == pytest.approx((0.03, 0.04, 0.06))
    expected = np.array([0.03, 0.04, 0.06]) / IRIS.inertia_B
    assert vehicles.nominal.torque_limit == pytest.approx(expected, rel=1e-4)
    assert vehicles.spreads["inertia_B.y"].high == pytest.approx(0.04 / 0.95, rel=1e-4)
    assert any("no unit" in line for line in file.findings)


def test_motors_alone_give_the_torque_of_all_on_one_side(perfect, tmp_path):
    found = perfect(IRIS, unit=CommandUnit.NORMALISED)
    gains = np.array([[-30.0, 31.0, 29.0, -30.0], [20.0, -20.0, 21.0, -20.0], [3.0, 3.0, -3.0, -3.0]])
    sums = np.abs(gains).sum(axis=1).tolist()
    axes = tuple(
        replace(axis, gain=Interval(0.9 * total, total, 1.1 * total))
        for axis, total in zip(found.axes, sums, strict=True)
    )
    found = replace(found, axes=axes, motor_gains=gains)
    vehicles = loaded(make_vehicle_file("mine", found, Known(mass=0.035)), tmp_path)
    limit = np.array([60.0, 41.0, 6.0]) * vehicles.nominal.inertia_B
    assert vehicles.nominal.torque_limit == pytest.approx(limit, rel=1e-4)
    assert vehicles.spreads["inertia_B.z"].low == pytest.approx(vehicles.nominal.inertia_B[2] / 1.1, rel=1e-4)


@pytest.mark.parametrize(
    ("unit", "motors", "known", "scale"),
    [
        (CommandUnit.NEWTON_METRES, False, Known(like="iris"), FullScale.ROTORS),
        (CommandUnit.NEWTON_METRES, False, Known(mass=1.5), FullScale.UNKNOWN),
        (CommandUnit.NORMALISED, True, Known(like="iris"), FullScale.UNKNOWN),
        (CommandUnit.NORMALISED, False, Known(mass=1.5), FullScale.MEASURED),
    ],
)
def test_a_log_in_newton_metres_knows_the_full_scale_only_of_rotors_that_are_known(
    perfect, tmp_path, unit, motors, known, scale
):
    found = replace(perfect(IRIS, unit=unit), motor_gains=np.ones((3, 4)) if motors else None)
    assert loaded(make_vehicle_file("mine", found, known), tmp_path).nominal.command.full_scale is scale


@pytest.mark.parametrize("factor", [0.02, 8.0])
def test_a_vehicle_of_another_mass_hovers_and_turns_alike(perfect, tmp_path, factor):
    found = perfect(IRIS, unit=CommandUnit.NORMALISED)
    vehicle = loaded(make_vehicle_file("mine", found, Known(mass=factor * IRIS.mass)), tmp_path).nominal
    assert vehicle.mass == factor * IRIS.mass
    assert vehicle.rotors.thrust_max / vehicle.mass == pytest.approx(IRIS.rotors.thrust_max / IRIS.mass, rel=1e-4)
    assert vehicle.span == pytest.approx(factor ** (1 / 3) * IRIS.span, rel=1e-4)
    # damping by the rotors' drag is a rate, that of the root of length
    damping = replace(vehicle, rate_damping=None).rate_damping_B
    assert damping == pytest.approx(np.array(IRIS.rate_damping_B) * factor ** (-1 / 6), rel=1e-3)


def test_without_a_mass_it_follows_from_the_inertia(perfect, tmp_path):
    file = make_vehicle_file("mine", perfect(IRIS), Known())
    assert loaded(file, tmp_path).nominal.mass == pytest.approx(IRIS.mass, rel=1e-4)
    assert any("weigh" in line for line in file.findings)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_that_is_not_excited_is_assumed_and_said(perfect, tmp_path, axis):
    file = make_vehicle_file("mine", without(perfect(IRIS), axis), Known(like="iris"))
    vehicles = loaded(file, tmp_path)
    assert vehicles.nominal.inertia_B == pytest.approx(IRIS.inertia_B, rel=1e-3)
    assert f"{('roll', 'pitch', 'yaw')[axis]} assumed, 30 % either way" in file.text
    share = vehicles.spreads[f"inertia_B.{'xyz'[axis]}"].low / IRIS.inertia_B[axis]
    assert 0.69 < share < 0.76  # less would be no rigid body's beside the others


def test_an_inertia_that_no_body_has_is_corrected_and_said(perfect, tmp_path):
    found = perfect(IRIS)
    yaw = replace(found.axes[2], gain=Interval(14.0, 15.0, 16.0))  # 1/15 is more than 2 * .029125
    file = make_vehicle_file("mine", replace(found, axes=(*found.axes[:2], yaw)), Known(like="iris"))
    x, y, z = loaded(file, tmp_path).nominal.inertia_B
    assert z <= x + y
    assert any("which no body has" in line for line in file.findings)


def test_every_number_tells_its_origin(perfect):
    file = make_vehicle_file("mine", perfect(IRIS), Known(like="iris", mass=1.6))
    lines = file.text.splitlines()
    for key, origin in {"mass": "given", "inertia_B": "measured", "actuator_lag": "measured", "span": "taken"}.items():
        (line,) = (line for line in lines if line.startswith(f"{key} = "))
        assert origin in line
    assert all("#" in line for line in lines if line.startswith("["))
    assert tomllib.loads(file.text)["mass"] == 1.6


@pytest.mark.parametrize(
    ("known", "unit", "said"),
    [
        (Known(inertia_B=(1.0, 1.0, 1.0)), CommandUnit.NEWTON_METRES, "measure the inertia"),
        (Known(like="no-such"), CommandUnit.NEWTON_METRES, "no vehicle named 'no-such'"),
        (Known(like="iris", thrust_max=1.0), CommandUnit.NEWTON_METRES, "thrust_max"),
    ],
)
def test_numbers_that_are_missing_or_wrong_are_named_in_one_line(perfect, known, unit, said):
    with pytest.raises(ConfigError, match=said) as error:
        make_vehicle_file("mine", perfect(IRIS, unit=unit), known)
    assert "\n" not in str(error.value)


def test_without_a_mass_one_is_assumed_and_gains_do_not_depend_on_it(perfect, tmp_path):
    """A log of commands without a unit tells torque over inertia: the road from it to gains needs no scale."""
    found = perfect(IRIS, unit=CommandUnit.NORMALISED)
    file = make_vehicle_file("mine", found, Known())
    told = (
        "the mass of 1.5 kg is assumed: of iris, as neither mass nor inertia is given: gains and margins do not depend"
    )
    assert file.findings[0].startswith(told)
    assert "# [kg] assumed" in next(line for line in file.text.splitlines() if line.startswith("mass = "))
    heavy = loaded(make_vehicle_file("mine", found, Known(mass=6.0)), tmp_path).nominal
    mine = loaded(file, tmp_path).nominal
    one, other = (np.divide(each.torque_limit, each.inertia_B) for each in (mine, heavy))
    np.testing.assert_allclose(one, other, rtol=1e-5)
    assert mine.actuator_lag == heavy.actuator_lag


def test_a_log_that_excites_nothing_gives_no_vehicle_but_the_manoeuvre(perfect):
    with pytest.raises(ConfigError, match="fly a chirp"):
        make_vehicle_file("mine", without(without(perfect(IRIS), 0), 1), Known(like="iris"))


@pytest.mark.parametrize(("delay", "told"), [(0.0019, False), (0.0021, True)])
def test_a_delay_is_told_from_two_milliseconds_on(perfect, delay, told):
    found = replace(perfect(IRIS), delay=Interval(delay - 1e-3, delay, delay + 1e-3))
    findings = make_vehicle_file("mine", found, Known(like="iris")).findings
    assert any(line.startswith("torque begins 2.1 ms after its command") for line in findings) is told
    assert any("torque begins" in line for line in findings) is told


def test_a_spread_is_never_narrower_than_a_thousandth(perfect, tmp_path):
    found = perfect(IRIS)
    exact = replace(found, actuator_lag=Interval(0.05, 0.05, 0.05))
    lag = loaded(make_vehicle_file("mine", exact, Known(like="iris")), tmp_path).spreads["actuator_lag"]
    assert (lag.low, lag.high) == pytest.approx((0.05 * 0.999, 0.05 * 1.001), rel=1e-5)
