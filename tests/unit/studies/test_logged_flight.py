"""What the log of one flight tells, and of which vehicles it tells nothing."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.read.flight_log import CommandUnit, FlightLog, LogSignal
from gustproof.studies.logged_flight import check_class, refutation, study_log

WHEELS = "MAV_TYPE 10: of a rover, only multicopters are identified"


def log_of(system: str, parameters: dict[str, float]) -> FlightLog:
    still = LogSignal(time=0.01 * np.arange(400), values=np.zeros((400, 3)))
    return FlightLog(source="x.ulg", system=system, gyro=still, command=still, parameters=parameters)


@pytest.mark.parametrize(
    ("system", "parameters", "said"),
    [
        ("px4", {"MAV_TYPE": 10.0, "MC_ROLLRATE_P": 0.15}, WHEELS),
        ("px4", {"CA_AIRFRAME": 1.0, "MC_ROLLRATE_P": 0.15}, "CA_AIRFRAME 1: of a plane"),
        ("px4", {"FW_RR_P": 0.05}, "FW_RR_P: of a plane"),
        ("ardupilot", {"RLL_RATE_P": 0.1, "PTCH_RATE_P": 0.1}, "RLL_RATE_P, PTCH_RATE_P: of a plane (ArduPlane)"),
        ("ardupilot", {"FRAME_CLASS": 6.0, "ATC_RAT_RLL_P": 0.1}, "FRAME_CLASS 6: of a helicopter"),
    ],
)
def test_the_log_of_another_class_of_vehicle_is_refused_by_name(system, parameters, said):
    """Rudders answer commands too: their gain stood in the file of a multirotor."""
    with pytest.raises(ConfigError, match=r"x\.ulg: ") as refused:
        check_class(log_of(system, parameters))
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("system", "parameters"),
    [
        ("px4", {"MAV_TYPE": 22.0, "CA_AIRFRAME": 2.0, "FW_RR_P": 0.05, "MC_ROLLRATE_P": 0.15}),
        ("px4", {}),
        ("ardupilot", {"RLL_RATE_P": 0.1, "Q_A_RAT_RLL_P": 0.1}),
        ("ardupilot", {"RATE_RLL_P": 0.15}),
        ("betaflight", {"RLL_RATE_P": 0.1}),
    ],
)
def test_what_hovers_is_identified_whatever_its_gains_are_called(system, parameters):
    check_class(log_of(system, parameters))


def test_a_page_on_another_class_of_vehicle_has_no_vehicle_and_says_why():
    found = study_log(log_of("px4", {"MAV_TYPE": 10.0}), "mine", progress=lambda *_: None)
    assert found.no_vehicle == f"x.ulg: {WHEELS}"
    assert found.no_judgement == f"no vehicle: x.ulg: {WHEELS}"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, "yet they flew 20 s in this log with 4.8 % of full torque, where that of an unstable loop grows"),
        ({"size": 2.2}, ""),  # as in a limit cycle
        ({"stop": 9.0}, ""),
        ({"unit": CommandUnit.NEWTON_METRES}, ""),
    ],
)
def test_a_calm_flight_refutes_a_model_by_which_its_gains_are_unstable(changes, told):
    """Ten times the integral of yaw was written, as a hover of 77 s was unstable by a model of a filled-in command."""
    time = 0.01 * np.arange(3000)
    size = np.where((time > 1.0) & (time < 21.0), changes.get("size", 1.0), 9.0)  # beside the flight, on the ground
    values = 0.05 * size[:, None] * np.linspace(-1.0, 1.0, 3000)[np.random.default_rng(1).permutation(3000), None] + 0.3
    log = replace(
        log_of("px4", {}),
        command=LogSignal(time=time, values=np.tile(values, 3)),
        command_unit=changes.get("unit", CommandUnit.NORMALISED),
        airborne=((1.0, changes.get("stop", 21.0)),),
    )
    assert refutation(log).startswith(told)
    assert bool(refutation(log)) == bool(told)
