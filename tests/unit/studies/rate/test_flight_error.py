"""The error that a flight would have had with other gains, held against the same gusts flown with them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.numerics.rotations import euler_angles
from gustproof.airframe.hover import hover_plant
from gustproof.design.loops.models import autopilot_law
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import Law
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.studies.rate.flight_error import _responses, flight_errors
from gustproof.studies.rate.judge import scenario_for

_IRIS = load_vehicle("iris")
IRIS = replace(_IRIS, gyro=replace(_IRIS.gyro, snr_db=120.0))
"""Without noise, whose walk moves the true attitude but not the one that an autopilot sees."""
AIR = replace(load_scenario("paper-turbulence"), duration_s=60.0)
FIRMER = {"MC_ROLLRATE_K": 1.4, "MC_PITCHRATE_I": 0.5, "MC_YAW_P": 1.5, "IMU_GYRO_CUTOFF": 60.0}


def px4(**values: float) -> Law:
    return autopilot_law("px4", values, IRIS).law


STEPS = load_scenario("attitude-steps")
"""Nearly all of a flight's error is made by its set-points."""


def log_flight(
    law: Law, scenario: Scenario = AIR, *, spacing: int = 1, turns: float = 0.0, late: float = 0.0
) -> FlightLog:
    """Return the log of a flight, each `spacing`th sample.

    Its yaw is `turns` whole turns from the set-point, which is logged `late` [s] after the attitude.
    """
    script = scenario_for(law, IRIS, scenario)
    records = fly_direct(script, law, vehicle=IRIS, seed=3)[::spacing]
    time, angles = records["time_us"] * 1e-6, euler_angles(records["q_NB"]) + np.array([0.0, 0.0, 2.0 * np.pi * turns])
    wanted = np.array([script.reference_at(spacing * sample) for sample in range(len(time))])
    reference = LogSignal(time=time + late, values=wanted)
    return FlightLog(
        source="flight.ulg",
        system="px4",
        gyro=LogSignal(time=time, values=records["gyro_B"]),
        attitude=LogSignal(time=time, values=angles),
        reference=reference,
        airborne=((0.0, scenario.duration_s),),
    )


@pytest.mark.parametrize("form", [{}, {"spacing": 5, "turns": 1.0, "late": 0.003}])
def test_another_law_s_error_is_that_of_its_flight_in_the_same_gusts(form: dict[str, float]) -> None:
    flown, other = px4(), px4(**FIRMER)
    script = scenario_for(flown, IRIS, AIR)
    was, there = flight_errors(log_flight(flown, **form), flown, [flown, other], IRIS, script)
    (measured,) = flight_errors(log_flight(other, **form), other, [other], IRIS, script)
    np.testing.assert_allclose(there, measured, rtol=0.03)
    assert not np.any(np.isclose(was, measured, rtol=0.1))


def test_the_error_by_set_points_is_that_of_the_flight_with_other_gains() -> None:
    flown, other = px4(), px4(**FIRMER)
    script = scenario_for(flown, IRIS, STEPS)
    was, there = flight_errors(log_flight(flown, STEPS), flown, [flown, other], IRIS, script)
    (measured,) = flight_errors(log_flight(other, STEPS), other, [other], IRIS, script)
    np.testing.assert_allclose(there, measured, rtol=0.05)
    assert np.max(np.abs(np.divide(was, measured) - 1.0)) > 0.1


def test_a_set_point_whose_rate_is_fed_forward_makes_the_error_of_a_disturbance() -> None:
    flown, other = px4(), px4(**FIRMER)
    script, log = scenario_for(flown, IRIS, AIR), log_flight(flown)
    time, omega = np.arange(0.0, 60.0, 0.02), 2.0 * np.pi * np.array([9, 21, 47, 95]) / 60.0
    P = np.diagonal(hover_plant(IRIS, script).response(omega), axis1=1, axis2=2)
    tones = np.exp(1j * (np.outer(time, omega) + omega**2))
    of_flown, of_other = (0.01 * np.real(tones @ -_responses(law, P, omega)[0]) for law in (flown, other))
    wanted = 0.01 * np.real(tones @ np.ones((4, 3)))
    signals = {"attitude": wanted + of_flown, "reference": wanted}
    log = replace(log, **{name: LogSignal(time=time, values=values) for name, values in signals.items()})
    (there,) = flight_errors(log, flown, [other], IRIS, script)
    np.testing.assert_allclose(there, np.std(of_other, axis=0), rtol=0.03)
    assert not np.allclose(there, np.std(of_flown, axis=0), rtol=0.1)


def test_a_heading_that_is_off_makes_no_error_of_a_thrust_that_points_as_wanted() -> None:
    law, time = px4(), np.arange(0.0, 30.0, 0.02)
    wanted = 0.2 * np.column_stack([np.sin(time), np.cos(2.0 * time), np.sin(0.5 * time)])
    off = 0.1 * np.sin(3.0 * time)
    turned = Rotation.from_euler("ZYX", wanted[:, ::-1]) * Rotation.from_euler("Z", off[:, None])
    flown = turned.as_euler("ZYX")[:, ::-1] + np.array([0.0, 0.0, 2.0])  # its heading is of another frame
    signals = {"gyro": np.zeros((1500, 3)), "attitude": flown, "reference": wanted}
    logged = {name: LogSignal(time=time, values=values) for name, values in signals.items()}
    log = FlightLog(source="flight.bin", system="ardupilot", airborne=((0.0, 30.0),), **logged)
    ((roll, pitch, yaw),) = flight_errors(log, law, [law], IRIS, scenario_for(law, IRIS, AIR))
    assert max(roll, pitch) < 2e-3  # .01 by their angles
    assert yaw == pytest.approx(np.std(off), rel=0.05)


def test_the_measured_error_is_the_rms_of_the_flight() -> None:
    law, log = px4(), log_flight(px4())
    assert log.attitude is not None
    (found,) = flight_errors(log, law, [law], IRIS, scenario_for(law, IRIS, AIR))
    assert all(0.8 < x < 1.02 for x in np.array(found) / np.std(log.attitude.values, axis=0))


def test_a_log_that_is_short_slow_or_has_no_set_points_tells_no_error() -> None:
    law, log = px4(), log_flight(px4())
    script = scenario_for(law, IRIS, AIR)
    rare = LogSignal(time=np.arange(0.0, 60.0, 3.0), values=np.zeros((20, 3)))
    for changed in ({"reference": None}, {"attitude": None}, {"airborne": ((0.0, 15.0),)}, {"reference": rare}):
        assert flight_errors(replace(log, **changed), law, [law], IRIS, script) == []
