"""What the log of one flight tells, and of which vehicles it tells nothing."""

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.studies.logged_flight import check_class, study_log

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
