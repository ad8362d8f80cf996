"""Plant, on-board loop and the delay between them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.events import Payload
from firmware_model.config.scenario import GyroFault, Scenario, load_scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle, load_vehicle
from firmware_model.config.waveforms import Constant, MomentRamp, MomentSine
from firmware_model.numerics.rotations import euler_angles, from_euler
from firmware_model.numerics.soa import single
from firmware_model.physics.battery import BatteryState
from firmware_model.recording.journal import RECORD, record_type
from firmware_model.sim.layout import X_BATTERY, X_LOAD
from firmware_model.sim.state import initial_state
from firmware_model.sim.step import measure_load
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import (
    AttitudeTarget,
    LevelFlight,
    MotorsOff,
    PositionTarget,
    RotorCommand,
    Setpoint,
    TorqueCommand,
    Trim,
)

VEHICLE = load_vehicle("paper")
QUIET = Scenario(name="quiet", description="", duration_s=8.0, gyro=GyroFault(noise=False))


def fly(scenario: Scenario, command: Setpoint, seed: int = 1, vehicle: Vehicle = VEHICLE) -> np.ndarray:
    loop = VehicleLoop(vehicle, scenario, seed)
    records = [loop.advance(command, 0).copy() for _ in range(scenario.samples)]
    assert loop.finished
    return np.array(records).view(RECORD)[:, 0]


def torque(roll: float, pitch: float = 0.0, yaw: float = 0.0) -> TorqueCommand:
    return TorqueCommand(time_us=0, torque_B=(roll, pitch, yaw), throttle=0.5)


@pytest.mark.parametrize("delay", [0, 1, 5])
def test_a_command_acts_the_stated_number_of_samples_later(delay: int) -> None:
    scenario = Scenario(name="d", description="", duration_s=0.1, delay_samples=delay)
    acting = fly(scenario, torque(0.1))["torque_command_B"][:, 0]
    assert not acting[:delay].any()
    np.testing.assert_allclose(acting[delay:], 0.1 * VEHICLE.torque_limit[0])


def test_the_age_of_a_command_is_counted_from_the_sample_that_it_answers() -> None:
    loop = VehicleLoop(VEHICLE, replace(QUIET, delay_samples=2), 1)
    answers = [torque(0.0)._replace(time_us=4000 * sample) for sample in (0, 1, 1, 1, 2)]
    on_board = (Trim(), LevelFlight())
    ages = [loop.advance(setpoint, 0).view(RECORD)["command_age"][0, 0] for setpoint in (*answers, *on_board)]
    np.testing.assert_array_equal(ages, [math.nan, math.nan, 2.0, 2.0, 3.0, 4.0, math.nan])


def test_whole_milliseconds_of_a_stamp_do_not_age_an_attitude_target() -> None:
    loop = VehicleLoop(VEHICLE, replace(QUIET, control_rate_hz=400, physics_rate_hz=2000), 1)
    rates = AttitudeTarget(time_us=0, q_NB=None, omega_B=(0.0, 0.0, 0.0), thrust=0.5)
    targets = [rates._replace(time_us=2500 * sample // 1000 * 1000) for sample in range(9)]
    ages = [loop.advance(target, 0).view(RECORD)["command_age"][0, 0] for target in targets]
    assert ages[1:] == [1.0] * 8


@pytest.mark.parametrize("name", ["iris", "octo"])
def test_thrusts_of_rotors_command_the_torque_of_their_places(name: str) -> None:
    rotors = load_vehicle(name).rotors
    given = tuple(np.random.default_rng(1).uniform(0.2, 0.8, rotors.count).tolist())
    loop = VehicleLoop(load_vehicle(name), replace(QUIET, delay_samples=0), 1)
    loop.advance(AttitudeTarget(time_us=0, q_NB=None, omega_B=(0.2, 0.0, 0.0), thrust=0.5), 0)
    record = loop.advance(RotorCommand(time_us=4000, rotors=given, clamped=False), 0)
    up = np.array(given) * rotors.thrust_max
    torque = np.cross(rotors.position_B, np.outer(up, (0.0, 0.0, -1.0))).sum(axis=0)
    torque[2] += rotors.drag_ratio * (np.array(rotors.spin) @ up)
    found = record.view(record_type(rotors.count))[0]
    np.testing.assert_allclose(found["torque_command_B"], torque, rtol=1e-12)
    assert np.all(np.isnan(found["omega_command_B"]))
    loop.advance(RotorCommand(time_us=8000, rotors=given, clamped=True), 0)
    assert loop.on_ground  # clamped on the stand


def test_a_sample_stays_the_same_until_the_vehicle_advances() -> None:
    loop = VehicleLoop(VEHICLE, load_scenario("calm"), 1)
    first = loop.observe()
    assert loop.observe() is first
    loop.advance(LevelFlight(), 0)
    assert loop.observe().time_us == 4000


def test_the_on_board_loop_turns_to_an_attitude_and_holds_it() -> None:
    target = AttitudeTarget(time_us=0, q_NB=from_euler(0.3, -0.2, 0.5), omega_B=None, thrust=0.5)
    angles = euler_angles(fly(QUIET, target)["q_NB"])
    np.testing.assert_allclose(angles[-1], (0.3, -0.2, 0.5), atol=2e-3)


def test_the_on_board_loop_tracks_body_rates() -> None:
    target = AttitudeTarget(time_us=0, q_NB=None, omega_B=(0.2, 0.0, -0.1), thrust=0.5)
    records = fly(QUIET, target)
    np.testing.assert_allclose(records["omega_B"][-1], (0.2, 0.0, -0.1), atol=2e-3)
    np.testing.assert_allclose(records["omega_command_B"][1:], [(0.2, 0.0, -0.1)] * (len(records) - 1))


@pytest.mark.parametrize("mass", [VEHICLE.mass, 0.03])
def test_without_a_controller_the_vehicle_levels_itself_in_a_steady_torque(mass: float) -> None:
    """A light one too: on the stand no ground bears it, not by the least force, which would empty its integral."""
    # .3 N m at 1e-6 rad/s and a quarter turn of phase: constant for the flight.
    push = MomentSine(kind="sine", amplitude_nm=(0.3, 0.0, 0.0), rate_rad_s=1e-6, phase_rad=math.pi / 2)
    scenario = Scenario(name="p", description="", duration_s=8.0, moment=(push,), gyro=GyroFault(noise=False))
    records = fly(scenario, LevelFlight(), vehicle=replace(VEHICLE, mass=mass))
    assert abs(euler_angles(records["q_NB"])[-1, 0]) < 2e-3  # the integral carries the torque
    assert records["torque_command_B"][-1, 0] == pytest.approx(-0.3, rel=0.02)


def test_lost_commands_on_their_way_are_dropped_when_the_controller_is_lost() -> None:
    loop = VehicleLoop(VEHICLE, QUIET, 1)
    loop.advance(torque(1.0), 0)
    assert abs(loop.advance(LevelFlight(), 0).view(RECORD)[0]["torque_command_B"][0]) < 1.0
    assert abs(loop.advance(LevelFlight(), 0).view(RECORD)[0]["torque_command_B"][0]) < 1.0


def test_the_torque_stays_inside_its_limit_and_the_rate_integral_does_not_wind_up() -> None:
    spin = AttitudeTarget(time_us=0, q_NB=None, omega_B=(30.0, 0.0, 0.0), thrust=0.5)
    loop = VehicleLoop(VEHICLE, QUIET, 1)
    for _ in range(100):
        record = loop.advance(spin, 0).view(RECORD)[0]
        assert abs(record["torque_command_B"][0]) <= VEHICLE.torque_limit[0]
    still = AttitudeTarget(time_us=0, q_NB=None, omega_B=(0.0, 0.0, 0.0), thrust=0.5)
    rates = [loop.advance(still, 0).view(RECORD)[0]["omega_B"][0] for _ in range(1500)]
    assert min(rates) > -0.5 * max(rates)  # a wound-up integral would throw it far to the other side


def test_the_strapdown_attitude_follows_the_truth() -> None:
    loop = VehicleLoop(VEHICLE, QUIET, 1)
    target = AttitudeTarget(time_us=0, q_NB=from_euler(0.5, 0.4, -0.8), omega_B=None, thrust=0.5)
    for _ in range(1000):
        loop.advance(target, 0)
    loop.observe()
    np.testing.assert_allclose(loop.estimate_q_NB, loop.q_NB, atol=1e-4)


def test_the_same_seed_gives_the_same_bits_and_another_does_not() -> None:
    scenario = Scenario(name="s", description="", duration_s=0.5, wind=load_scenario("paper").wind)
    assert fly(scenario, LevelFlight(), 3).tobytes() == fly(scenario, LevelFlight(), 3).tobytes()
    assert fly(scenario, LevelFlight(), 3).tobytes() != fly(scenario, LevelFlight(), 4).tobytes()


def test_a_flight_twice_as_long_begins_identically() -> None:
    wind = load_scenario("paper").wind
    short = Scenario(name="s", description="", duration_s=0.5, wind=wind)
    long = Scenario(name="s", description="", duration_s=1.0, wind=wind)
    assert fly(long, LevelFlight())[: short.samples].tobytes() == fly(short, LevelFlight()).tobytes()


def test_a_gyro_fault_leaves_every_gust_as_it_was() -> None:
    wind = load_scenario("paper").wind
    sound = fly(Scenario(name="s", description="", duration_s=0.5, wind=wind), LevelFlight())
    faulty = fly(
        Scenario(name="s", description="", duration_s=0.5, wind=wind, gyro=GyroFault(bias_rad_s=(0.1, 0.0, 0.0))),
        LevelFlight(),
    )
    np.testing.assert_array_equal(sound["gust_B"], faulty["gust_B"])
    np.testing.assert_allclose((faulty["gyro_B"] - sound["gyro_B"])[0], (0.1, 0.0, 0.0), atol=1e-8)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_out_of_range_is_refused(seed: int) -> None:
    with pytest.raises(ValueError, match="seed is"):
        VehicleLoop(VEHICLE, QUIET, seed)


def test_after_touchdown_the_rotors_carry_three_tenths_of_the_weight() -> None:
    loop = VehicleLoop(VEHICLE, replace(QUIET, translation="free"), 1, interactive=True)
    assert loop.on_ground  # before anything else is observed
    for _ in range(250):
        loop.advance(PositionTarget((0.0, 0.0, 0.0), yaw=0.0, v_down=0.5), 0)
    assert loop.thrust * VEHICLE.rotors.total_thrust == pytest.approx(0.3 * VEHICLE.mass * GRAVITY)


def test_a_load_that_is_dropped_is_weight_off_the_feet() -> None:
    script = replace(QUIET, translation="free", event=(Payload(kind="payload", at_s=0.1, mass_kg=-0.3),))
    changes = initial_state(VEHICLE, script, 1).changes
    before = VEHICLE.mass * GRAVITY
    (places,) = (np.flatnonzero(initial_state(VEHICLE, script, 1).params == before),)
    after = {int(at): value for _, at, value in changes}
    assert (VEHICLE.mass - 0.3) * GRAVITY in [pytest.approx(after[at]) for at in places.tolist() if at in after]


def test_off_clamps_on_the_stand_and_the_next_set_point_frees() -> None:
    push = MomentSine(kind="sine", amplitude_nm=(0.5, 0.3, 0.1), rate_rad_s=2.0)
    loop = VehicleLoop(VEHICLE, replace(QUIET, moment=(push,)), 1, interactive=True)
    assert loop.on_ground
    for _ in range(250):
        loop.advance(LevelFlight(), 0)
    assert not loop.on_ground
    loop.observe()
    caught = loop.q_NB
    for _ in range(250):
        record = loop.advance(MotorsOff(), 0).view(RECORD)[0]
    loop.observe()
    assert loop.q_NB == loop.estimate_q_NB == caught
    assert not record["omega_B"].any()
    assert loop.on_ground
    assert loop.thrust == pytest.approx(0.0, abs=1e-8)  # 20 time constants
    assert not loop.finished


def test_on_the_stand_the_rotors_turn_as_in_hover_and_share_out_the_torque() -> None:
    records = fly(QUIET, torque(0.2))
    weight = VEHICLE.mass * GRAVITY
    np.testing.assert_allclose(records["rotors"].sum(axis=1), weight)
    arms = np.array(VEHICLE.rotors.position_B)[:, 1]
    np.testing.assert_allclose(-records["rotors"] @ arms, records["torque_B"][:, 0], atol=1e-12)
    loop = VehicleLoop(VEHICLE, QUIET, 1)
    loop.advance(Trim(), 0)
    assert loop.rotors == pytest.approx([weight / VEHICLE.rotors.total_thrust] * loop.rotor_count)


def test_a_steady_wind_gives_no_moment_on_the_stand() -> None:
    wind = Constant(kind="constant", velocity_mps=(10.0, 5.0, 0.0))
    blown, still = fly(replace(QUIET, wind=(wind,)), LevelFlight()), fly(QUIET, LevelFlight())
    np.testing.assert_array_equal(blown["wind_N"], [(10.0, 5.0, 0.0)] * len(blown))
    for field in set(RECORD.names or ()) - {"wind_N"}:
        assert blown[field].tobytes() == still[field].tobytes(), field


def test_on_board_loop_takes_over_with_the_moment_that_the_torque_held_against() -> None:
    moment, rise = 4.0, 250  # [N*m], and the samples of its growth; the controller allows for lag and delay
    late_s = VEHICLE.actuator_lag + QUIET.delay_samples * QUIET.dt
    push = MomentRamp(kind="ramp", amplitude_nm=(moment, 0.0, 0.0), rise_s=rise * QUIET.dt, start_s=late_s)
    scenario = replace(QUIET, moment=(push,), duration_s=4.0)
    share = -moment / VEHICLE.torque_limit[0]
    commands = [torque(share * min(sample / rise, 1.0)) for sample in range(2 * rise)]
    loop = VehicleLoop(VEHICLE, scenario, 1)
    q_NB = np.array(
        [loop.advance(each, 0).view(RECORD)["q_NB"][0].copy() for each in (*commands, *[LevelFlight()] * 500)]
    )
    roll = np.degrees(euler_angles(q_NB)[:, 0])
    assert np.abs(roll[2 * rise :] - roll[2 * rise]).max() < 2.0  # from empty integrals it is 16


@pytest.mark.parametrize("hold_s", [0.3, 3.0, 12.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 10.0, 20.0, 40.0])
def test_set_point_that_the_ground_does_not_follow_winds_nothing_up(tilt_deg: float, hold_s: float) -> None:
    loop = VehicleLoop(VEHICLE, replace(QUIET, translation="free"), 1, interactive=True)
    half = math.radians(0.5 * tilt_deg)
    standing = AttitudeTarget(time_us=0, q_NB=(math.cos(half), math.sin(half), 0.0, 0.0), omega_B=None, thrust=0.05)
    for _ in range(round(250 * hold_s)):
        loop.advance(standing, 0)
        assert loop.on_ground
    tilts = []
    for _ in range(625):
        loop.advance(standing._replace(q_NB=(1.0, 0.0, 0.0, 0.0), thrust=0.6), 0)
        _, x, y, _ = loop.q_NB
        tilts.append(math.degrees(math.acos(1.0 - 2.0 * (x * x + y * y))))
    assert loop.true_vector("position_N")[2] < -1.0
    assert max(tilts) < 2.0


def test_torques_on_the_ground_leave_nothing_for_the_rate_loop_that_takes_over() -> None:
    loop = VehicleLoop(VEHICLE, replace(QUIET, translation="free"), 1, interactive=True)
    for _ in range(500):
        loop.advance(TorqueCommand(time_us=0, torque_B=(0.3, 0.3, 0.0), throttle=0.05), 0)
    assert loop.on_ground
    level = AttitudeTarget(time_us=0, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=None, thrust=0.05)
    for _ in range(3):  # one acts a sample later, and is read a sample after that
        loop.advance(level, 0)
    loop.observe()
    assert max(map(abs, loop.torque_command)) < 0.02


@pytest.mark.parametrize("ahead", [(0.0, 0.0, 0.25), (0.0, 0.0, -0.25), (0.5, -0.125, 0.25)])
def test_rates_beside_an_attitude_are_fed_forward_with_their_signs(ahead: tuple[float, float, float]) -> None:
    scenario = replace(QUIET, duration_s=0.008)
    target = AttitudeTarget(time_us=0, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=ahead, thrust=None)
    record = fly(scenario, target)[-1]
    assert tuple(record["omega_command_B"]) == ahead
    assert np.array_equal(np.sign(record["torque_command_B"]), np.sign(ahead))


def test_the_ground_has_a_vehicle_from_a_tenth_of_its_weight_on() -> None:
    loop = VehicleLoop(VEHICLE, replace(QUIET, translation="free"), 1, interactive=True)
    loop.observe()
    tenth = 0.1 * VEHICLE.mass * GRAVITY
    for load, on_ground in ((tenth, True), (math.nextafter(tenth, 0.0), False)):
        loop._sim.state[X_LOAD] = load
        assert loop.on_ground is on_ground


def test_vehicle_begins_without_load_moment_or_applied_event() -> None:
    state = initial_state(VEHICLE, QUIET, 1).state
    assert not state[X_LOAD:X_BATTERY].any()
    assert (X_BATTERY - X_LOAD, len(state) - X_BATTERY) == (5, len(BatteryState()))


@pytest.mark.parametrize("stands", [True, False])
def test_load_of_a_law_that_feels_no_force_is_the_weight_on_the_feet_and_none_in_the_air(stands: bool) -> None:
    whole = initial_state(VEHICLE, replace(QUIET, translation="free"), 1, interactive=stands)
    whole.state[X_LOAD] = 7.0  # of a sample before
    measure_load(single(whole.params), single(whole.state))
    assert whole.state[X_LOAD] == pytest.approx(VEHICLE.mass * GRAVITY * stands)


def test_on_the_stand_level_flight_asks_for_the_rates_of_a_level_attitude() -> None:
    tilted = AttitudeTarget(time_us=0, q_NB=from_euler(0.3, -0.2, 0.1), omega_B=None, thrust=None)
    level = AttitudeTarget(time_us=0, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=None, thrust=None)
    asked = []
    for setpoint in (level, LevelFlight()):
        loop = VehicleLoop(VEHICLE, replace(QUIET, delay_samples=0), 1)
        for _ in range(250):
            loop.advance(tilted, 0)
        asked.append(tuple(loop.advance(setpoint, 0).view(RECORD)[0]["omega_command_B"]))
    assert asked[0] == asked[1]
    assert asked[0][0] < -0.5
