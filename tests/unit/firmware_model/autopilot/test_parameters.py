import math
import struct
from dataclasses import replace

import pytest

from firmware_model.autopilot.modes import FailSafe, Settings
from firmware_model.autopilot.parameters import ParameterRejectReason, Parameters, published_limit
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle


@pytest.fixture
def parameters() -> Parameters:
    vehicle = replace(load_vehicle("paper"), torque_limit=(1.5, 0.9, 0.35))
    return Parameters(vehicle, load_scenario("calm"))


def test_published_limits_are_float32():
    vehicle = replace(load_vehicle("paper"), torque_limit=(1.5, 0.9, 0.35))
    assert published_limit(vehicle) == (1.5, 0.8999999761581421, 0.3499999940395355)


def test_limits_are_parameters_in_newton_metres(parameters):
    assert [parameters[f"GP_TRQ_MAX_{axis}"] for axis in "RPY"] == [1.5, 0.8999999761581421, 0.3499999940395355]


def test_thrust_that_hovers_carries_the_weight_by_four_rotors(parameters):
    vehicle = load_vehicle("paper")
    assert parameters["MPC_THR_HOVER"] * 4.0 * vehicle.rotors.thrust_max == pytest.approx(9.80665 * vehicle.mass, 1e-6)


def test_integers_travel_bytewise(parameters):
    value, integer = parameters.wire_value("IMU_INTEG_RATE")
    assert integer
    assert struct.pack("<f", value) == (250).to_bytes(4, "little")


def test_real_parameter_is_set_within_its_range(parameters):
    assert parameters.set_wire_value("COM_OF_LOSS_T", 2.5, integer=False) is None
    assert parameters["COM_OF_LOSS_T"] == 2.5


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 0.0, 61.0])
def test_value_outside_the_range_is_refused_and_the_old_one_stays(parameters, value):
    assert parameters.set_wire_value("COM_OF_LOSS_T", value, integer=False) is ParameterRejectReason.OUT_OF_RANGE
    assert parameters["COM_OF_LOSS_T"] == 1.0


def test_what_describes_the_vehicle_is_read_only(parameters):
    assert parameters.set_wire_value("GP_TRQ_MAX_R", 3.0, integer=False) is ParameterRejectReason.READ_ONLY
    assert parameters["GP_TRQ_MAX_R"] == 1.5


def test_names_fit_the_wire(parameters):
    assert all(len(parameter.name) <= 16 for parameter in parameters.table)


def test_cast_integers_travel_as_their_value():
    parameters = Parameters(load_vehicle("paper"), load_scenario("calm"), bytewise=False)
    assert parameters.wire_value("COM_OBL_RC_ACT") == (2.0, False)
    assert parameters.set_wire_value("COM_OBL_RC_ACT", 5.0, integer=False) is None
    assert parameters["COM_OBL_RC_ACT"] == 5
    assert isinstance(parameters["COM_OBL_RC_ACT"], int)
    assert parameters.set_wire_value("COM_OBL_RC_ACT", 4.5, integer=False) is ParameterRejectReason.OUT_OF_RANGE


def test_defaults_are_allowed_and_are_the_autopilots_own(parameters):
    assert parameters.settings() == Settings()
    assert all(parameter.read_only or parameter.is_allowed(parameter.default) for parameter in parameters.table)


def test_set_parameters_reach_the_autopilot(parameters):
    for name, value in (
        ("COM_OF_LOSS_T", 2.0),
        ("MIS_TAKEOFF_ALT", 7.0),
        ("RTL_RETURN_ALT", 9.0),
        ("MPC_LAND_SPEED", 1.0),
    ):
        assert parameters.set_wire_value(name, value, integer=False) is None
    land = struct.unpack("<f", struct.pack("<i", 4))[0]
    assert parameters.set_wire_value("COM_OBL_RC_ACT", land, integer=True) is None
    assert parameters.settings() == Settings(
        stream_timeout_us=2_000_000, fail_safe=FailSafe.LAND, takeoff_height=7.0, return_height=9.0, land_speed=1.0
    )


def test_reference_tells_each_parameter_with_its_meaning(parameters):
    rows = parameters.describe()
    assert [row["name"] for row in rows] == [parameter.name for parameter in parameters.table]
    assert all(row["meaning"] and row["allowed"] for row in rows)
    (loss,) = [row for row in rows if row["name"] == "COM_OF_LOSS_T"]
    assert (loss["default"], loss["unit"], loss["allowed"], loss["type"]) == (1.0, "s", "0.1 to 60", "REAL32")


def test_clients_find_px4s_names_in_its_units_with_these_ranges():
    rows = Parameters(load_vehicle("iris"), load_scenario("calm")).describe()
    told = {row["name"]: (row["type"][:3], row["default"], row["unit"], row["allowed"]) for row in rows}
    limits = {"roll": 1.5, "pitch": 0.9, "yaw": 0.35}  # [N*m]
    inertia = {"roll": 0.029125, "pitch": 0.029125, "yaw": 0.055225}
    rate_gains = {"P": (16.0, 16.0, 8.0), "I": (10.0, 10.0, 5.0), "D": (0.3, 0.3, 0.0)}
    ranges = {"P": ("s/rad", "0.001 to 10"), "I": ("1/rad", "0 to 10"), "D": ("s^2/rad", "0 to 1")}
    expected = {f"GP_TRQ_MAX_{axis[0].upper()}": ("REA", limit, "N*m", "read-only") for axis, limit in limits.items()}
    for axis, limit in limits.items():
        for term, gains in rate_gains.items():
            share = float(f"{gains[list(limits).index(axis)] * inertia[axis] / limit:.7g}")
            expected[f"MC_{axis.upper()}RATE_{term}"] = ("REA", share, *ranges[term])
    for sensor in ("GYRO", "ACC", "MAG"):
        expected[f"CAL_{sensor}0_ID"] = ("INT", 1_310_988, "", "read-only")
    assert told == expected | {
        "IMU_INTEG_RATE": ("INT", 250, "Hz", "read-only"),
        "COM_OF_LOSS_T": ("REA", 1.0, "s", "0.1 to 60"),
        "COM_OBL_RC_ACT": ("INT", 2, "", "2, 4, 5"),
        "MIS_TAKEOFF_ALT": ("REA", 2.5, "m", "1 to 500"),
        "RTL_RETURN_ALT": ("REA", 15.0, "m", "0 to 500"),
        "MPC_LAND_SPEED": ("REA", 0.5, "m/s", "0.2 to 1.5"),
        "MPC_THR_HOVER": ("REA", 0.5204197, "", "read-only"),
        "GP_GUST_SCALE": ("REA", 1.0, "", "0 to 3"),
        "GP_PAUSE": ("INT", 0, "", "0, 1"),
        "GP_ATT_P": ("REA", 6.0, "1/s", "0.1 to 20"),
        "GP_RATE_MAX": ("REA", 217.724, "deg/s", "10 to 1800"),
        "IMU_DGYRO_CUTOFF": ("REA", 30.0, "Hz", "1 to 100"),
        "MPC_XY_P": ("REA", 0.8, "1/s", "0.05 to 5"),
        "MPC_XY_VEL_P_ACC": ("REA", 1.8, "1/s", "0.1 to 20"),
        "MPC_XY_VEL_I_ACC": ("REA", 0.4, "1/s^2", "0 to 20"),
        "MPC_XY_VEL_MAX": ("REA", 8.0, "m/s", "0.5 to 20"),
        "MPC_Z_P": ("REA", 1.0, "1/s", "0.05 to 5"),
        "MPC_Z_VEL_P_ACC": ("REA", 4.0, "1/s", "0.1 to 20"),
        "MPC_Z_VEL_I_ACC": ("REA", 2.0, "1/s^2", "0 to 20"),
        "MPC_Z_VEL_MAX_UP": ("REA", 3.0, "m/s", "0.2 to 10"),
        "MPC_Z_VEL_MAX_DN": ("REA", 1.5, "m/s", "0.2 to 4"),
        "MPC_TILTMAX_AIR": ("REA", 35.00199, "deg", "5 to 60"),
        "COM_RC_IN_MODE": ("INT", 4, "", "read-only"),
        "SYS_AUTOSTART": ("INT", 4001, "", "read-only"),
        "SYS_HAS_MAG": ("INT", 1, "", "read-only"),
    }
