import math
import struct
from dataclasses import replace

import pytest

from firmware_model.params import Parameters, Refusal, published_limit
from firmware_model.scenario import load_scenario
from firmware_model.vehicle import load_vehicle


@pytest.fixture
def parameters() -> Parameters:
    vehicle = replace(load_vehicle("paper"), torque_limit=(1.5, 0.9, 0.35))
    return Parameters(vehicle, load_scenario("calm"))


def test_published_limits_are_float32():
    vehicle = replace(load_vehicle("paper"), torque_limit=(1.5, 0.9, 0.35))
    assert published_limit(vehicle) == (1.5, 0.8999999761581421, 0.3499999940395355)


def test_limits_are_parameters_in_newton_metres(parameters):
    assert [parameters[f"GP_TRQ_MAX_{axis}"] for axis in "RPY"] == [1.5, 0.8999999761581421, 0.3499999940395355]


def test_integers_travel_bytewise(parameters):
    value, integer = parameters.wire_value("IMU_INTEG_RATE")
    assert integer
    assert struct.pack("<f", value) == (250).to_bytes(4, "little")


def test_real_parameter_is_set_within_its_range(parameters):
    assert parameters.set_wire_value("COM_OF_LOSS_T", 2.5, integer=False) is None
    assert parameters["COM_OF_LOSS_T"] == 2.5


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 0.0, 61.0])
def test_value_outside_the_range_is_refused_and_the_old_one_stays(parameters, value):
    assert parameters.set_wire_value("COM_OF_LOSS_T", value, integer=False) is Refusal.OUT_OF_RANGE
    assert parameters["COM_OF_LOSS_T"] == 1.0


def test_what_describes_the_vehicle_is_read_only(parameters):
    assert parameters.set_wire_value("GP_TRQ_MAX_R", 3.0, integer=False) is Refusal.READ_ONLY
    assert parameters["GP_TRQ_MAX_R"] == 1.5


def test_names_fit_the_wire(parameters):
    assert all(len(parameter.name) <= 16 for parameter in parameters.table)
