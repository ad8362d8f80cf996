"""Every primitive of wind and moment against its formula, in both frames, from its start to its stop."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from firmware_model.config.scenario import GyroFault, Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import (
    Constant,
    GustCosine,
    GustRamp,
    GustReplay,
    GustSine,
    GustStep,
    GustSweep,
    Moment,
    MomentCosine,
    MomentRamp,
    MomentReplay,
    MomentSine,
    MomentSquare,
    MomentStep,
    MomentSweep,
    Shear,
    Wind,
)
from firmware_model.errors import ConfigError
from firmware_model.physics.disturbances import Disturbance, disturbance, make_replay, make_waves
from firmware_model.physics.mean_wind import mean_wind, mean_wind_params
from firmware_model.recording.journal import RECORD
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import LevelFlight, Setpoint, TorqueCommand, Vector

QUIET = Scenario(name="quiet", description="", duration_s=10.0, gyro=GyroFault(noise=False))
VEHICLE = load_vehicle("paper")
PEAK = (1.0, -2.0, 0.5)
ROWS = ((0.0, 1.0, 0.0, 0.0), (2.0, 3.0, -1.0, 0.0), (3.0, 0.0, 0.0, 2.0))
HELD = TorqueCommand(time_us=0, torque_B=(0.0, 0.0, 0.0), throttle=None)


def at(scenario: Scenario, time: float) -> Disturbance:
    """Return what acts at the sample of a time."""
    sample = round(time * scenario.control_rate_hz)
    return disturbance(make_waves(scenario), make_replay(scenario), sample, sample * scenario.sample_us * 1e-6)


def fly(scenario: Scenario, setpoint: Setpoint = HELD) -> np.ndarray:
    loop = VehicleLoop(VEHICLE, scenario, 1)
    return np.array([loop.advance(setpoint, 0).copy() for _ in range(scenario.samples)]).view(RECORD)[:, 0]


def in_body(q_NB: np.ndarray, v_N: Vector) -> np.ndarray:
    return np.asarray(Rotation.from_quat(np.roll(q_NB, -1)).inv().apply(v_N))


# Each primitive from 2 s to 7 s: as gust, as moment, and its formula of the time since the start.
SHAPES: list[tuple[Wind, Moment, Callable[[float], float]]] = [
    (
        GustStep(kind="step", amplitude_mps=PEAK, start_s=2.0, stop_s=7.0),
        MomentStep(kind="step", amplitude_nm=PEAK, start_s=2.0, stop_s=7.0),
        lambda s: 1.0,
    ),
    (
        GustRamp(kind="ramp", amplitude_mps=PEAK, start_s=2.0, stop_s=7.0, rise_s=1.5),
        MomentRamp(kind="ramp", amplitude_nm=PEAK, start_s=2.0, stop_s=7.0, rise_s=1.5),
        lambda s: min(s / 1.5, 1.0),
    ),
    (
        GustCosine(kind="one_minus_cosine", amplitude_mps=PEAK, start_s=2.0, stop_s=7.0, length_s=4.0),
        MomentCosine(kind="one_minus_cosine", amplitude_nm=PEAK, start_s=2.0, stop_s=7.0, length_s=4.0),
        lambda s: 0.5 * (1.0 - math.cos(2.0 * math.pi * s / 4.0)) if s < 4.0 else 0.0,
    ),
    (
        GustSine(kind="sine", amplitude_mps=PEAK, start_s=2.0, stop_s=7.0, rate_rad_s=3.0, phase_rad=0.4),
        MomentSine(kind="sine", amplitude_nm=PEAK, start_s=2.0, stop_s=7.0, rate_rad_s=3.0, phase_rad=0.4),
        lambda s: math.sin(3.0 * s + 0.4),
    ),
    (
        GustSweep(
            kind="sine_sweep", amplitude_mps=PEAK, start_s=2.0, stop_s=7.0, rate_from_rad_s=1.0, rate_to_rad_s=11.0
        ),
        MomentSweep(
            kind="sine_sweep", amplitude_nm=PEAK, start_s=2.0, stop_s=7.0, rate_from_rad_s=1.0, rate_to_rad_s=11.0
        ),
        lambda s: math.sin(s + s * s),  # the integral of 1 + 2 s
    ),
]


@pytest.mark.parametrize(("gust", "moment", "formula"), SHAPES, ids=[gust.kind for gust, _, _ in SHAPES])
def test_a_primitive_follows_its_formula_in_its_time_and_is_nothing_outside(
    gust: Wind, moment: Moment, formula: Callable[[float], float]
) -> None:
    of_body = replace(QUIET, wind=(gust,), moment=(moment,))
    is_earth_frame = replace(QUIET, wind=(replace(gust, frame="ned"),), moment=(replace(moment, frame="ned"),))
    nothing = (0.0, 0.0, 0.0)
    for time in np.arange(0.0, 10.0, 0.1).tolist():
        inside = 2.0 <= round(time, 6) < 7.0
        expected = tuple(formula(time - 2.0) * x for x in PEAK) if inside else nothing
        gust_B, gust_N, moment_B, moment_N = at(of_body, time)
        assert gust_B == moment_B == pytest.approx(expected, abs=1e-9)
        assert gust_N == moment_N == nothing
        assert at(is_earth_frame, time) == (nothing, gust_B, nothing, moment_B)


def test_a_square_moment_has_its_full_amplitude_at_all_times_and_the_sign_of_its_sine() -> None:
    square = MomentSquare(kind="square", amplitude_nm=PEAK, rate_rad_s=2.0, phase_rad=0.5)
    for time in np.linspace(0.0, 10.0, 101).tolist():
        sign = math.copysign(1.0, math.sin(2.0 * time + 0.5))
        assert at(replace(QUIET, moment=(square,)), time)[2] == tuple(sign * x for x in PEAK)


def test_primitives_add_up() -> None:
    winds = tuple(gust for gust, _, _ in SHAPES)
    alone = [at(replace(QUIET, wind=(wind,)), 3.3)[0] for wind in winds]
    assert at(replace(QUIET, wind=winds), 3.3)[0] == pytest.approx(np.sum(alone, axis=0))


def test_a_replay_is_linear_between_its_rows_and_calm_outside() -> None:
    gust = GustReplay(kind="replay", rows=ROWS, start_s=1.0)
    moment = MomentReplay(kind="replay", rows=ROWS, start_s=1.0, stop_s=3.5)
    scenario = replace(QUIET, wind=(gust, replace(gust, frame="body", start_s=4.0)), moment=(moment,))
    assert at(scenario, 0.996)[1] == (0.0, 0.0, 0.0)
    assert at(scenario, 1.0)[1] == (1.0, 0.0, 0.0)
    assert at(scenario, 2.0)[1] == pytest.approx((2.0, -0.5, 0.0))
    assert at(scenario, 3.5)[1] == pytest.approx((1.5, -0.5, 1.0))
    assert at(scenario, 4.004)[1] == (0.0, 0.0, 0.0)
    assert at(scenario, 5.0)[0] == pytest.approx((2.0, -0.5, 0.0))
    assert at(scenario, 2.0)[2] == pytest.approx((2.0, -0.5, 0.0))
    assert at(scenario, 3.5)[2] == (0.0, 0.0, 0.0)
    assert at(scenario, 60.0) == ((0.0, 0.0, 0.0),) * 4


@pytest.mark.parametrize("late_us", [-0.6, -0.4, 0.0, 0.4, 0.6])
def test_starts_and_stops_count_to_half_a_microsecond(late_us: float) -> None:
    """Seconds are no whole number of samples in binary: of 2,000 replays 605 once lost their first or last row."""
    for sample in (126, 150, 275, 1999):
        edge = sample / QUIET.control_rate_hz + 1e-6 * late_us
        for begin, stop in ((edge, edge + 0.5), (edge - 0.5, edge), (edge - 0.5, None)):
            step = GustStep(kind="step", amplitude_mps=PEAK, start_s=begin, stop_s=stop)
            rows = ((0.0, *PEAK), (0.5, *PEAK))
            replay = GustReplay(kind="replay", rows=rows, start_s=begin, stop_s=stop, frame="body")
            late_rows = tuple((time + begin, *vector) for time, *vector in rows)
            later = replace(replay, rows=late_rows, start_s=0.0)
            acts = late_us < 0.5 if begin == edge else late_us > 0.5 if stop else late_us > -0.5
            for wind in (step, replay, later)[stop is None :]:
                assert at(replace(QUIET, wind=(wind,)), edge)[0] == (PEAK if acts else (0.0, 0.0, 0.0))


def test_tables_have_a_row_for_each_wave_and_each_sample_of_a_replay() -> None:
    assert make_replay(QUIET).shape == (0, 12)
    assert make_waves(QUIET).shape == (0, 9)
    replayed = replace(QUIET, wind=(GustReplay(kind="replay", rows=ROWS),))
    assert make_replay(replayed).shape == (QUIET.samples, 12)
    assert make_waves(replace(QUIET, wind=tuple(gust for gust, _, _ in SHAPES))).shape == (len(SHAPES), 9)


def test_a_replay_whose_rows_begin_later_is_calm_until_then() -> None:
    late = tuple((time + 0.5, *vector) for time, *vector in ROWS)
    scenario = replace(QUIET, wind=(GustReplay(kind="replay", rows=late, start_s=1.0),))
    assert at(scenario, 1.496)[1] == (0.0, 0.0, 0.0)
    assert at(scenario, 1.5)[1] == (1.0, 0.0, 0.0)
    assert at(scenario, 4.5)[1] == (0.0, 0.0, 2.0)
    assert at(scenario, 4.504)[1] == (0.0, 0.0, 0.0)


def written(folder: Path, table: str, csv: str = "time_s,north_mps,east_mps,down_mps\n0,1,2,3\n1,4,5,6\n") -> Path:
    (folder / "gusts.csv").write_text(csv)
    path = folder / "mine.toml"
    path.write_text(f'description = "a test"\nduration_s = 1.0\n{table}\n')
    return path


REPLAY = '[[wind]]\nkind = "replay"\nfile = "gusts.csv"'


def test_a_replay_reads_its_file_beside_the_scenario_and_the_header_names_the_frame(tmp_path: Path) -> None:
    (wind,) = load_scenario(written(tmp_path, REPLAY)).wind
    assert isinstance(wind, GustReplay)
    assert (wind.frame, wind.rows) == ("ned", ((0.0, 1.0, 2.0, 3.0), (1.0, 4.0, 5.0, 6.0)))
    (wind,) = load_scenario(written(tmp_path, REPLAY, "time_s,u_mps,v_mps,w_mps\n0,1,2,3\n1,4,5,6\n")).wind
    assert isinstance(wind, GustReplay)
    assert wind.frame == "body"
    (moment,) = load_scenario(
        written(tmp_path, REPLAY.replace("wind", "moment"), "time_s,L_nm,M_nm,N_nm\n0,1,2,3\n1,4,5,6\n")
    ).moment
    assert isinstance(moment, MomentReplay)
    assert moment.frame == "body"


@pytest.mark.parametrize(
    ("table", "csv", "message"),
    [
        (REPLAY, "t,x,y,z\n0,1,2,3\n", "first line must be time_s,north_mps,east_mps,down_mps or time_s,u_mps"),
        (REPLAY, "", "first line must be"),
        (REPLAY, "time_s,u_mps,v_mps,w_mps\n0,1,2\n", "row 1: must be four numbers"),
        (REPLAY, "time_s,u_mps,v_mps,w_mps\n0,1,2,nan\n", "row 1: must be four numbers"),
        (REPLAY, "time_s,u_mps,v_mps,w_mps\n0,1,2,3\n", "at least 2 items"),
        (REPLAY, "time_s,u_mps,v_mps,w_mps\n1,1,2,3\n0,1,2,3\n", "times must rise"),
        (REPLAY + '\nframe = "ned"', "time_s,u_mps,v_mps,w_mps\n0,1,2,3\n1,1,2,3\n", "has columns in 'body'"),
        (REPLAY.replace("gusts", "none"), "", "No such file"),
        ('[[wind]]\nkind = "replay"', "", "rows: missing"),
    ],
)
def test_a_bad_replay_is_one_line_that_names_the_key(tmp_path: Path, table: str, csv: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scenario(written(tmp_path, table, csv))
    assert message in str(caught.value)
    assert "wind.0" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("from_deg", "toward"), [(0.0, (-4.0, 0.0)), (90.0, (0.0, -4.0)), (225.0, (4.0 / 2**0.5, 4.0 / 2**0.5))]
)
def test_a_bearing_is_where_the_wind_comes_from(from_deg: float, toward: tuple[float, float]) -> None:
    steady = Constant(kind="constant", speed_mps=4.0, from_deg=from_deg)
    gust = GustStep(kind="step", speed_mps=4.0, from_deg=from_deg)
    assert steady.velocity_N == gust.vector == pytest.approx((*toward, 0.0))
    assert gust.is_earth_frame


def test_shear_is_the_logarithm_of_the_height_over_the_roughness() -> None:
    shear = Shear(kind="shear", wind_speed_20ft_mps=6.0, from_deg=180.0)
    params = mean_wind_params([shear, Constant(kind="constant", velocity_mps=(0.0, 2.0, 0.0))])
    foot = 0.3048
    for feet in (5.0, 20.0, 300.0):
        north = 6.0 * math.log(feet / 2.0) / math.log(20.0 / 2.0)
        assert mean_wind(params, feet * foot) == pytest.approx((north, 2.0, 0.0))
    assert mean_wind(params, 0.0) == mean_wind(params, 3.0 * foot)


def test_a_free_vehicle_drifts_the_way_the_wind_blows_and_faster_higher_up() -> None:
    wind = Constant(kind="constant", speed_mps=5.0, from_deg=270.0)  # from the west: it is carried east
    free = replace(QUIET, translation="free", duration_s=5.0)
    level = TorqueCommand(time_us=0, torque_B=(0.0, 0.0, 0.0), throttle=None)
    east = fly(replace(free, wind=(wind,)), LevelFlight())["position_N"][-1]
    assert east[1] > 1.0
    assert abs(east[0]) < 1e-3 * east[1]
    step = GustStep(kind="step", speed_mps=5.0, from_deg=180.0)  # from the south: it is carried north
    assert fly(replace(free, wind=(step,)), LevelFlight())["position_N"][-1][0] > 1.0
    shear = Shear(kind="shear", wind_speed_20ft_mps=5.0, from_deg=0.0)
    low, high = (
        fly(replace(free, wind=(shear,), altitude_m=h, duration_s=2.0), level)["position_N"][-1][0] for h in (3.0, 50.0)
    )
    assert high < low < 0.0


def test_a_held_vehicle_leans_the_way_the_wind_blows_in_its_own_axes() -> None:
    step = GustStep(kind="step", amplitude_mps=(3.0, 2.0, 0.0), frame="ned", stop_s=0.5)
    records = fly(replace(QUIET, wind=(step,), duration_s=1.0))
    assert records["moment_B"][0] == pytest.approx((2.0 * VEHICLE.gust_gain, -3.0 * VEHICLE.gust_gain, 0.0))
    assert records["omega_B"][60, 0] > 0.0 > records["omega_B"][60, 1]
    # It turns; the wind does not: what the vehicle feels is N turned into B.
    for record in records[:125:20]:
        np.testing.assert_allclose(record["gust_B"], in_body(record["q_NB"], (3.0, 2.0, 0.0)), atol=1e-12)
    assert not records["gust_B"][125:].any()


def test_a_moment_of_the_earth_is_turned_into_body_axes() -> None:
    push = MomentStep(kind="step", amplitude_nm=(0.5, 0.0, 0.0), frame="ned")
    spin = MomentStep(kind="step", amplitude_nm=(0.0, 0.0, 0.3))
    records = fly(replace(QUIET, moment=(push, spin), duration_s=2.0))
    for record in records[::100]:
        expected = np.add(in_body(record["q_NB"], (0.5, 0.0, 0.0)), (0.0, 0.0, 0.3))
        np.testing.assert_allclose(record["moment_B"], expected, atol=1e-12)


def test_a_flight_twice_as_long_begins_identically_with_every_primitive() -> None:
    replay = GustReplay(kind="replay", rows=ROWS, start_s=0.1)
    winds = (*(gust for gust, _, _ in SHAPES), replay, Shear(kind="shear", wind_speed_20ft_mps=5.0, from_deg=0.0))
    short = replace(QUIET, wind=winds, moment=tuple(moment for _, moment, _ in SHAPES), duration_s=3.0)
    long = replace(short, duration_s=6.0)
    assert fly(long)[: short.samples].tobytes() == fly(short).tobytes()
    assert fly(short).tobytes() == fly(short).tobytes()
