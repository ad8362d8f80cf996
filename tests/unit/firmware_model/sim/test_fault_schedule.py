"""What events change, from which sample on, and that nothing else changes."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from firmware_model.config.events import (
    ActuatorEffect,
    ActuatorLag,
    ActuatorLimit,
    Event,
    GyroBias,
    GyroNoise,
    GyroRange,
    Payload,
    RotorFailure,
)
from firmware_model.config.files import validate
from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario
from firmware_model.config.vehicle import GRAVITY, load_vehicle
from firmware_model.config.waveforms import MomentStep
from firmware_model.errors import ConfigError
from firmware_model.recording.journal import RECORD
from firmware_model.sim.fault_schedule import fault_schedule
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import LevelFlight, Setpoint, TorqueCommand

VEHICLE = load_vehicle("paper")
QUIET = Scenario(
    name="quiet",
    description="",
    duration_s=2.0,
    physics_rate_hz=500,
    gyro=GyroFault(noise=False),
    accelerometer=AccelerometerFault(noise=False),
)
AT = 250
"""Sample of 1 s."""
REST = TorqueCommand(time_us=0, torque_B=(0.0, 0.0, 0.0), throttle=None)


def fly(scenario: Scenario, *events: Event, setpoint: Setpoint = REST, seed: int = 1) -> np.ndarray:
    loop = VehicleLoop(VEHICLE, replace(scenario, event=events), seed)
    return np.array([loop.advance(setpoint, 0).copy() for _ in range(scenario.samples)]).view(RECORD)[:, 0]


def scripted(**table: Any) -> Scenario:
    return validate(Scenario, {"name": "a", "description": "b", "duration_s": 1.0, **table}, "mine.toml")


def test_a_bias_is_there_from_its_sample_on_and_the_next_takes_its_place() -> None:
    first = GyroBias(kind="gyro_bias", at_s=1.0, bias_rad_s=(0.25, 0.0, -0.5))
    second = GyroBias(kind="gyro_bias", at_s=1.5, bias_rad_s=(0.0, 0.125, 0.0))
    gyro = fly(replace(QUIET, gyro=GyroFault(noise=False, bias_rad_s=(1.0, 0.0, 0.0))), second, first)["gyro_B"]
    np.testing.assert_array_equal(gyro[:AT], [(1.0, 0.0, 0.0)] * AT)
    np.testing.assert_array_equal(gyro[AT:375], [(0.25, 0.0, -0.5)] * 125)
    np.testing.assert_array_equal(gyro[375:], [(0.0, 0.125, 0.0)] * 125)


def test_a_bias_drifts_linearly_and_stays_where_it_arrives() -> None:
    drift = GyroBias(kind="gyro_bias", at_s=0.5, bias_rad_s=(0.3, 0.0, 0.1), over_s=1.0)
    other = GyroNoise(kind="gyro_noise", at_s=1.0, factor=0.0)
    gyro = fly(replace(QUIET, gyro=GyroFault(noise=False, bias_rad_s=(0.1, 0.0, 0.0))), drift, other)["gyro_B"]
    share = np.clip((np.arange(500) * 0.004 - 0.5) / 1.0, 0.0, 1.0)
    np.testing.assert_allclose(gyro, np.outer(1 - share, (0.1, 0.0, 0.0)) + np.outer(share, (0.3, 0.0, 0.1)), atol=1e-7)
    assert np.ptp(gyro[375:, 0]) == 0.0


def test_drifts_of_the_bias_follow_each_other() -> None:
    first = {"kind": "gyro_bias", "at_s": 0.0, "bias_rad_s": [0.1, 0, 0], "over_s": 0.6}
    scripted(event=[first, {**first, "at_s": 0.6}])
    with pytest.raises(ConfigError, match=r"gyro_bias' at 0\.5 s begins before the one before it ends"):
        scripted(event=[first, {**first, "at_s": 0.5}])


def test_noise_grows_by_its_factor_and_its_draws_stay() -> None:
    noisy = replace(QUIET, gyro=GyroFault())
    plain = fly(noisy)["gyro_B"]
    loud = fly(noisy, GyroNoise(kind="gyro_noise", at_s=1.0, factor=4.0))["gyro_B"]
    np.testing.assert_array_equal(loud[:AT], plain[:AT])
    np.testing.assert_allclose(loud[AT:], 4.0 * plain[AT:], rtol=1e-6)


def test_a_gyro_clips_at_its_new_range() -> None:
    push = MomentStep(kind="step", amplitude_nm=(0.2, 0.0, 0.0))
    records = fly(replace(QUIET, moment=(push,)), GyroRange(kind="gyro_range", at_s=1.0, range_rad_s=0.5))
    assert records["omega_B"][AT - 1, 0] > 0.75
    assert records["gyro_B"][AT - 1, 0] > 0.75
    assert set(records["gyro_B"][AT:, 0]) == {0.5}


def test_a_loss_of_effect_leaves_a_share_of_what_is_asked() -> None:
    ask = REST._replace(torque_B=(0.1, 0.1, -0.1))
    records = fly(QUIET, ActuatorEffect(kind="actuator_effect", at_s=1.0, share=(0.5, 1.0, 0.0)), setpoint=ask)
    full = 0.1 * np.array(VEHICLE.torque_limit)
    np.testing.assert_allclose(records["torque_command_B"][1:], [full * (1, 1, -1)] * 499, rtol=1e-6)
    np.testing.assert_allclose(records["torque_B"][AT], full * (1.0, 1.0, -1.0), rtol=1e-2)
    np.testing.assert_allclose(records["torque_B"][-1], full * (0.5, 1.0, 0.0), rtol=1e-6, atol=1e-8)


def test_a_weaker_actuator_gives_its_limit_and_no_more() -> None:
    ask = REST._replace(torque_B=(0.1, 0.02, -0.1))
    limit = ActuatorLimit(kind="actuator_limit", at_s=1.0, torque_limit_nm=(0.4, 0.4, 0.4))
    records = fly(QUIET, limit, setpoint=ask)
    np.testing.assert_allclose(records["torque_B"][-1], (0.4, 0.2, -0.4), rtol=1e-6)


def test_an_actuator_answers_with_its_new_lag() -> None:
    ask = REST._replace(torque_B=(0.1, 0.0, 0.0))
    records = fly(replace(QUIET, delay_samples=0), ActuatorLag(kind="actuator_lag", at_s=0.0, lag_s=0.2), setpoint=ask)
    assert records["torque_B"][50, 0] == pytest.approx(1.0 - math.exp(-1.0), rel=1e-3)  # one time constant
    with pytest.raises(ConfigError, match="at least a step"):
        scripted(physics_rate_hz=500, event=[{"kind": "actuator_lag", "at_s": 0.0, "lag_s": 0.001}])


def test_a_payload_changes_mass_and_inertia_and_another_adds_to_it() -> None:
    # Held: the same moment turns it the more slowly, by the inertias alone.
    drop = Payload(kind="payload", at_s=1.0, mass_kg=-2.0, inertia_kgm2=(-0.05, 0.0, 0.0))
    take = Payload(kind="payload", at_s=1.5, mass_kg=1.0, inertia_kgm2=(0.30, 0.0, 0.0))
    push = MomentStep(kind="step", amplitude_nm=(0.2, 0.0, 0.0))
    vehicle = replace(VEHICLE, rate_damping=0.0)
    loop = VehicleLoop(vehicle, replace(QUIET, moment=(push,), event=(drop, take)), 1)
    p = np.array([loop.advance(REST, 0).view(RECORD)[0]["omega_B"][0] for _ in range(500)])
    acceleration = np.diff(p) / 0.004
    np.testing.assert_allclose(acceleration[: AT - 1], 0.2 / 0.25, rtol=1e-9)
    np.testing.assert_allclose(acceleration[AT:374], 0.2 / 0.20, rtol=1e-9)
    np.testing.assert_allclose(acceleration[376:], 0.2 / 0.50, rtol=1e-9)


def test_a_free_vehicle_that_drops_its_payload_rises_until_the_height_is_held_again() -> None:
    free = replace(QUIET, translation="free", duration_s=8.0)
    drop = Payload(kind="payload", at_s=1.0, mass_kg=-2.0, inertia_kgm2=(0.0, 0.0, 0.0))
    records = fly(free, drop, setpoint=LevelFlight())
    felt = -records["specific_force_B"][:, 2]
    assert felt[AT - 1] == pytest.approx(GRAVITY, rel=1e-6)
    assert felt[AT] == pytest.approx(GRAVITY * 10.0 / 8.0, rel=1e-6)
    assert records["position_N"][375, 2] < records["position_N"][AT, 2]
    assert abs(records["velocity_N"][-1, 2]) < 0.05


def test_a_payload_that_leaves_no_vehicle_is_refused_in_one_line() -> None:
    drop = Payload(kind="payload", at_s=1.0, mass_kg=-20.0, inertia_kgm2=(0.0, 0.0, -1.0))
    with pytest.raises(ConfigError, match=r"event 'payload' at 1\.0 s: .*mass.*inertia_B") as caught:
        fly(QUIET, drop)
    assert "\n" not in str(caught.value)


def test_a_flight_with_events_begins_like_one_without_and_twice_as_long_begins_identically() -> None:
    events = (
        GyroBias(kind="gyro_bias", at_s=1.0, bias_rad_s=(0.01, 0.0, 0.0), over_s=3.0),
        Payload(kind="payload", at_s=1.2, mass_kg=-1.0, inertia_kgm2=(-0.01, 0.0, 0.0)),
        ActuatorEffect(kind="actuator_effect", at_s=1.4, share=(0.5, 0.5, 0.5)),
    )
    noisy = replace(QUIET, gyro=GyroFault())
    short, long = fly(noisy, *events), fly(replace(noisy, duration_s=4.0), *events)
    assert long[:500].tobytes() == short.tobytes() == fly(noisy, *events).tobytes()
    assert fly(noisy)[:AT].tobytes() == short[:AT].tobytes()
    assert fly(noisy).tobytes() != short.tobytes()


def test_an_event_holds_from_the_first_sample_at_or_after_its_time() -> None:
    assert [QUIET.sample_at(at_s) for at_s in (0.0, 0.004, 0.0041, 0.1 + 0.2, 1.0)] == [0, 1, 2, 75, 250]


def test_references_are_stamps_and_radians_in_order_of_time() -> None:
    later = {"kind": "attitude", "at_s": 0.5, "euler_deg": [0, 0, 180]}
    sooner = {"kind": "attitude", "at_s": 0.2001, "euler_deg": [90, 0, 0]}
    references = scripted(event=[later, sooner]).references
    assert references == ((204_000, (math.pi / 2, 0.0, 0.0)), (500_000, (0.0, 0.0, math.pi)))


def test_a_payload_as_a_share_is_that_part_of_the_vehicle_before_it() -> None:
    drop = {"kind": "payload", "at_s": 0.5, "mass_share": -0.3, "inertia_share": [-0.18, -0.225, -0.45]}
    take = {"kind": "payload", "at_s": 0.6, "mass_share": 0.5, "mass_kg": 1.0}
    plants = [plant.vehicle for _, plant in fault_schedule(VEHICLE, scripted(event=[drop, take]))]
    assert [vehicle.mass for vehicle in plants] == [7.0, 11.5]
    assert plants[1].inertia_B == plants[0].inertia_B == (0.25 - 0.045, 0.2 - 0.045, 0.1 - 0.045)


FREE = replace(QUIET, translation="free")


@pytest.mark.parametrize(("share", "given"), [(0.0, 0.0), (0.5, 12.25831)])
def test_a_failed_rotor_gives_its_share_at_once_and_drags_and_tilts_less(share: float, given: float) -> None:
    """Rotor 1 of the paper's, front right, in hover: what it loses is missing in thrust, roll, pitch and yaw."""
    records = fly(FREE, RotorFailure(kind="rotor_failure", at_s=1.0, rotor=1, share=share), setpoint=LevelFlight())
    hover = 10.0 * GRAVITY / 4.0
    lost = hover - given
    np.testing.assert_allclose(records["rotors"][AT - 1], hover, rtol=1e-9)
    np.testing.assert_allclose(records["rotors"][AT], (given, hover, hover, hover), rtol=1e-5)
    np.testing.assert_allclose(records["thrust_z"][AT], lost - 4.0 * hover, rtol=1e-6)
    np.testing.assert_allclose(records["torque_B"][AT], np.array((0.22, -0.22, -0.06)) * lost, rtol=1e-5)
    np.testing.assert_allclose(records["specific_force_B"][AT, 2], (lost - 4.0 * hover) / 10.0, rtol=1e-6)
    turned = (records["omega_B"][AT + 1] - records["omega_B"][AT]) / 0.004
    np.testing.assert_allclose(turned * VEHICLE.inertia_B, records["torque_B"][AT], rtol=0.05)


def test_a_rotor_that_is_sound_again_leaves_no_trace() -> None:
    failure = RotorFailure(kind="rotor_failure", at_s=1.0, rotor=2)
    again = RotorFailure(kind="rotor_failure", at_s=1.0, rotor=2, share=1.0)
    assert fly(FREE, failure, again).tobytes() == fly(FREE).tobytes()
    assert fly(FREE, failure).tobytes() != fly(FREE).tobytes()


def test_a_failure_of_a_rotor_that_is_not_there_is_refused_by_its_number() -> None:
    with pytest.raises(ConfigError, match="event 'rotor_failure': vehicle 'paper' has 4 rotors, no 5"):
        fly(FREE, RotorFailure(kind="rotor_failure", at_s=1.0, rotor=5))
