"""Identification against the truth: simulated logs of random vehicles, and real flights."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import savgol_filter

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle, load_vehicle
from firmware_model.errors import ConfigError
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.cascade import Gains, cascade_law, strapdown_axis
from gustproof.law.form import Law, Provenance
from gustproof.logs.identify import identify_vehicle
from gustproof.logs.identify.curves import Curves
from gustproof.logs.identify.filtered_command import filter_command
from gustproof.logs.identify.flown_step import flown_steps
from gustproof.logs.identify.gyro_spectrum import gyro_spectrum
from gustproof.logs.identify.identify_vehicle import (
    _advise,
    _Axis,
    _doubt_delay,
    _next_spacing,
    _widening,
    identify,
)
from gustproof.logs.identify.likelihood import DAMPING, DELAY, GAINS, LAG
from gustproof.logs.identify.sparse_command import fill_command
from gustproof.logs.identify.stretches import NEVER_FLEW, find_stretches
from gustproof.logs.read.flight_log import CommandUnit, FlightLog, LogSignal
from gustproof.logs.read.read_log import read_log
from gustproof.types import Array, Records

_Random = np.random.Generator


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """Numbers behind a simulated log."""

    gain: Array
    """(3,) [rad/s^2 per N*m]."""
    lag: float
    """[s]."""


def random_log(
    seed: int, *, duration: float = 60.0, excited: bool = True, windy: bool = True
) -> tuple[FlightLog, Truth]:
    """Return the log of a random vehicle, .03 to 25 kg, flown by a PID, and the truth behind it.

    Its control rate is 250 to 1000 Hz and its log keeps a whole fraction of the samples, at 100 Hz or more. Single
    samples are lost, and up to three stretches. The clocks of command and gyro differ, so the delay is no whole number
    of samples. Without `excited` the reference is level, without `windy` the air is still.
    """
    random = np.random.default_rng(seed)
    rate = int(random.choice([250, 500, 1000]))
    keep = int(random.choice([k for k in (1, 2, 4, 5) if rate % k == 0 and rate // k >= 100]))
    late = int(random.integers(0, round(0.015 * rate) + 1))
    offset, lag = random.uniform(0.0, 0.012), _log_uniform(random, 0.01, 0.12)
    quickness = random.uniform(0.25, 0.45) / (lag + late / rate + offset + 1.0 / rate)
    gains = Gains(
        angle_p=min(quickness * random.uniform(0.25, 0.4), 8.0),
        rate_p=min(quickness, 25.0),
        rate_i=quickness**2 * random.uniform(0.05, 0.2),
        rate_d=quickness * min(lag, 0.05) * random.uniform(0.0, 0.5),
    )
    vehicle = _random_vehicle(random, lag, gains.rate_p * gains.angle_p)
    law = _make_law(vehicle, gains, 1.0 / rate)
    calm = load_scenario("paper-turbulence")
    scenario = replace(
        calm,
        duration_s=duration,
        control_rate_hz=rate,
        physics_rate_hz=2000,
        delay_samples=late,
        require=(),
        wind=calm.wind if windy else (),
    )
    reference = _random_steps(random, scenario.samples, rate) * excited
    records = fly_direct(scenario, law, vehicle=vehicle, seed=seed, reference=reference)
    log = _write_log(random, records, reference, late, keep, offset)
    return log, Truth(
        gain=1.0 / np.array(vehicle.inertia_B),
        lag=lag,
    )


def _log_uniform(random: _Random, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _random_vehicle(random: _Random, lag: float, stiffness: float) -> Vehicle:
    """Return a vehicle whose gusts lean it by degrees under an attitude loop of some `stiffness` [1/s^2]."""
    paper, mass = load_vehicle("paper"), _log_uniform(random, 0.03, 25.0)
    size = (mass / paper.mass) ** (1.0 / 3.0)
    I_x = paper.inertia_B[0] * size**5 * _log_uniform(random, 0.6, 1.6)
    I_y = I_x * random.uniform(0.7, 1.3)
    I_z = max((I_x + I_y) * random.uniform(0.4, 0.95), 1.05 * abs(I_x - I_y))
    gust = stiffness * _log_uniform(random, 0.005, 0.06) / 2.5  # [rad/s^2 per m/s], in gusts of about 2.5 m/s
    a, b, c, d = ((size * x, size * y, size * z) for x, y, z in paper.rotors.position_B)
    return replace(
        paper,
        name="random",
        mass=mass,
        inertia_B=(I_x, I_y, I_z),
        actuator_lag=lag,
        torque_limit=(60.0 * I_x, 60.0 * I_y, 60.0 * I_z),
        span=size * paper.span,
        gust_gain=gust * I_x,
        gust_yaw_ratio=random.uniform(0.1, 0.5) * I_z / I_x,
        rate_damping=random.uniform(0.0, 0.5),
        rotors=replace(paper.rotors, position_B=(a, b, c, d), thrust_max=0.5 * GRAVITY * mass),
        gyro=replace(paper.gyro, snr_db=paper.gyro.snr_db + random.uniform(-9.5, 9.5)),
    )


def _make_law(vehicle: Vehicle, gains: Gains, dt: float) -> Law:
    axes = [strapdown_axis(gains, inertia, dt) for inertia in vehicle.inertia_B]
    return cascade_law("trial", axes, vehicle, dt, Provenance(design="trial", vehicle=vehicle.name))


def _random_steps(random: _Random, samples: int, rate: int) -> Array:
    """Return attitude references (samples, 3) [rad]: steps at random times, each axis on its own."""
    reference, largest = np.zeros((samples, 3)), np.radians(random.uniform(8.0, 25.0))
    for axis in range(3):
        begin = rate
        while begin < samples:
            end = begin + int(rate * random.uniform(0.3, 1.5))
            reference[begin:end, axis] = largest * random.uniform(-1.0, 1.0)
            begin = end
    return reference


def _write_log(random: _Random, records: Records, reference: Array, late: int, keep: int, offset: float) -> FlightLog:
    """Return the log of a flight: every `keep`-th sample, some lost; a command stands `offset` [s] early in it."""
    time = records["time_us"] * 1e-6
    kept = np.arange(0, len(time) - late, keep)
    kept = kept[random.random(len(kept)) > random.uniform(0.0, 0.05)]
    for _ in range(int(random.integers(0, 4))):
        begin = random.uniform(0.0, time[-1])
        kept = kept[(time[kept] < begin) | (time[kept] > begin + random.uniform(0.02, 0.3))]
    return FlightLog(
        source="trial",
        system="csv",
        gyro=LogSignal(time=time[kept], values=records["gyro_B"][kept]),
        command=LogSignal(time=time[kept] - offset, values=records["torque_command_B"][kept + late]),
        command_unit=CommandUnit.NEWTON_METRES,
        reference=LogSignal(time=time[kept], values=reference[kept]),
    )


@pytest.fixture(scope="module")
def brief() -> FlightLog:
    return random_log(1011, duration=20.0)[0]


@pytest.mark.slow
@pytest.mark.parametrize("means", [1, 2])
def test_filtered_gyro_is_used_with_wider_spacing(brief, means):
    """Means of samples, as PX4 logs them: their coloured noise once turned delay into lag.

    Of two samples, they hid the lag of PX4's own simulator, whose gyro has a hundred times the usual noise.
    """
    values = brief.gyro.values
    values = values + (2 - means) * 0.1 * np.random.default_rng(1).standard_normal(values.shape)
    for _ in range(means):
        values = 0.5 * (values + np.roll(values, 1, axis=0))
    time = brief.gyro.time - 0.5 * means * np.median(np.diff(brief.gyro.time))
    found = identify(replace(brief, gyro=LogSignal(time=time[2:], values=values[2:])))
    assert any("filtered before it is logged: one sample in 8 ms is used" in line for line in found.findings)
    truth = random_log(1011, duration=20.0)[1]
    assert found.actuator_lag.low < truth.lag < found.actuator_lag.high
    assert all(axis.gain.low < gain < axis.gain.high for axis, gain in zip(found.axes, truth.gain, strict=True))


def test_log_with_more_than_the_flight_is_told(brief):
    """Commands that move nothing, as before take-off, contradict those in flight."""
    still = np.where((brief.gyro.time > 10.0)[:, None], brief.gyro.values, 0.001)
    found = identify(replace(brief, gyro=LogSignal(time=brief.gyro.time, values=still)))
    assert all(axis.gain is None for axis in found.axes)


@pytest.mark.slow
def test_still_hover_is_told_as_unexcited():
    log, _ = random_log(1011, duration=30.0, excited=False, windy=False)
    found = identify(log)
    assert found.actuator_lag is None
    assert found.delay is None
    for axis in found.axes:
        assert axis.gain is axis.damping is axis.held_out_r2 is axis.disturbance_rms is axis.disturbance_corner is None
    for name, axis in zip(("roll", "pitch", "yaw"), found.axes, strict=True):
        assert axis.advice.startswith(f"{name} is not excited")
        assert "chirp" in axis.advice
        assert f"{name} is not identified" in found.findings


@pytest.mark.slow
def test_identification_predicts_and_repeats_its_bits(brief):
    told = list[float]()
    first, second = identify(brief, progress=told.append), identify(brief)
    assert told == sorted(told)
    assert 0.0 < told[0] < told[-1] <= 1.0
    assert [axis.gain for axis in first.axes] == [axis.gain for axis in second.axes]
    assert (first.actuator_lag, first.delay) == (second.actuator_lag, second.delay)
    assert all(np.array_equal(getattr(first, n), getattr(second, n)) for n in ("time", "predicted", "response"))
    assert min(axis.held_out_r2 for axis in first.axes) > 0.7
    assert first.acceleration.shape == first.predicted.shape == (len(first.time), 3)
    assert np.all(np.diff(first.time) > 0.0)


@pytest.mark.parametrize(("assumed", "delay", "told"), [(0.9, 0.005, True), (0.1, 0.005, False), (0.9, 0.04, False)])
def test_a_delay_that_is_assumed_is_told(assumed, delay, told):
    (line,) = _doubt_delay([SimpleNamespace(assumed=assumed, theta=np.array([0.0, delay]))]) or [""]
    assert line.startswith("delay: assumed more than measured, from a usual 8 ms, give or take 8:") == told
    assert _doubt_delay([]) == []


def test_measured_response_agrees_with_the_model(brief):
    shares = list[float]()
    found = identify(brief, progress=shares.append)
    assert shares == [0.02, 0.3, 0.6, 0.9]
    seen = found.coherence > 0.9
    assert np.all(seen.sum(axis=1) > 5)
    apart = np.abs(found.response / found.model - 1.0)[seen]
    assert np.median(apart) < 0.15
    pitch = found.axes[1]
    told = [*found.actuator_lag, *found.delay, *pitch.gain, *pitch.damping, pitch.disturbance_rms, pitch.noise]
    told += [pitch.held_out_r2, pitch.disturbance_corner, *found.lateness, found.omega[-1], len(found.omega)]
    settled = [  # by priors, widths and blocks: a change of a setting is meant
        *(0.0118555, 0.0123511, 0.0128420, 0.00202357, 0.00346781, 0.00491723, 1.388446, 1.416506, 1.447920),
        *(-0.546118, -0.109876, 0.435238, 1.450826, 0.000145550),
        *(0.942375, 0.131826, 0.0143753, 0.0158190, 0.0172659, 151.58184, 38),
    ]
    np.testing.assert_allclose(told, settled, rtol=2e-3)


@pytest.mark.slow
def test_clock_offset_of_the_command_is_its_delay(brief):
    near = identify(brief)
    early = replace(brief, command=LogSignal(time=brief.command.time - 0.005, values=brief.command.values))
    assert identify(early).delay.nominal - near.delay.nominal == pytest.approx(0.005, abs=5e-4)


@pytest.mark.slow
def test_slow_and_fast_motors_are_told_apart():
    """Four motors, thrust the square of a lagged command, in place of the torque command."""
    random, dt, lag = np.random.default_rng(1), 0.002, 0.06
    gains = np.array([[-300.0, -250.0, 280.0, 270.0], [260.0, -240.0, -290.0, 250.0], [30.0, -30.0, 30.0, -30.0]])
    held = np.repeat(0.5 + 0.05 * random.standard_normal((100, 4)), 100, axis=0)
    speed, rates = held[0].copy(), np.zeros((len(held), 3))
    for k in range(1, len(held)):
        speed += (held[k - 1] - speed) * -np.expm1(-dt / lag)
        rates[k] = rates[k - 1] + dt * (gains @ (speed**2 - 0.25) - rates[k - 1])
    time = dt * np.arange(len(held))
    noisy = rates + 0.01 * random.standard_normal(rates.shape)
    found = identify(
        FlightLog(
            source="x", system="csv", gyro=LogSignal(time=time, values=noisy), motors=LogSignal(time=time, values=held)
        )
    )
    assert found.actuator_lag.nominal == pytest.approx(lag, rel=0.03)
    assert found.motor_gains == pytest.approx(gains, rel=0.05)
    assert np.all(found.motor_intervals[..., 0] < found.motor_intervals[..., 1])


@pytest.mark.slow
def test_crazyflie_in_flight_is_predicted_over_its_last_third():
    """The whole flight has a lag of .0639 s, published is .072 s; another flight of that vehicle has .055 s."""
    found = identify(read_log(Path(__file__).parent / "data" / "crazyflie.log"))
    assert min(found.axes[0].held_out_r2, found.axes[1].held_out_r2) >= 0.85
    assert found.actuator_lag.low < 0.0639 < found.actuator_lag.high < 0.075
    roll, pitch, _ = found.motor_gains
    assert np.all(np.sign(roll) == [-1, -1, 1, 1])
    assert np.all(np.sign(pitch) == [1, -1, -1, 1])
    assert np.all((np.abs([roll, pitch]) > 200.0) & (np.abs([roll, pitch]) < 360.0))
    for axis in found.axes[:2]:  # its damping ends at 0, where it once was told as 0 (0 to 0)
        assert axis.damping.low < axis.damping.nominal < 0.0
        assert axis.damping.high > axis.damping.low + 0.5
    ends = [*found.actuator_lag, *found.delay, *found.axes[1].gain, *found.motor_intervals[0, 0]]
    settled = [0.0529766, 0.0610453, 0.0701283, 0.00550986, 0.00678510, 0.00812821, 840.359, 1028.869, 1260.847]
    np.testing.assert_allclose(ends, [*settled, -385.683, -192.405], rtol=2e-3)  # as above


def test_samples_just_closer_than_those_of_a_filtered_gyro_are_thinned(brief):
    """Of 100 Hz with jitter no sample was left out, again and again: a public log hung for minutes."""
    time = 0.00996 * np.arange(1000)
    log = replace(brief, gyro=LogSignal(time=time, values=np.zeros((1000, 3))))
    assert len(identify_vehicle._thin(log, 0.012).gyro.time) == 500


def test_logs_without_commands_or_too_short_are_refused(brief):
    with pytest.raises(ConfigError, match="neither torque commands nor motor outputs"):
        identify(replace(brief, command=None))
    with pytest.raises(ConfigError, match="too short"):
        identify(replace(brief, airborne=((1.0, 6.0),)))


def test_a_gyro_that_is_still_about_an_axis_shows_nothing_of_it(brief):
    """Of a simulator without noise, or of a dead sensor: it ended in a division by zero."""
    level = LogSignal(time=brief.gyro.time, values=brief.gyro.values * [1.0, 1.0, 0.0])
    roll, _, yaw = identify(replace(brief, gyro=level, airborne=((1.0, 16.0),))).axes
    assert roll.advice != yaw.advice
    assert yaw.gain is None


def test_a_log_that_was_never_in_the_air_shows_nothing(brief):
    """A vehicle on a bench answered its own commands: 74 % of its acceleration was explained."""
    log = replace(brief, airborne=())
    with pytest.raises(ConfigError, match="never in the air, by its landing detector or motors"):
        identify(log)
    steps, (reason,) = flown_steps(replace(log, rate_reference=brief.gyro))
    assert (steps, reason.partition(": ")[2]) == ([], NEVER_FLEW)
    assert gyro_spectrum(log) is None
    assert find_stretches(log, brief.command) == []


@pytest.mark.parametrize("share", [0.39, 0.41])
def test_a_command_that_is_guessed_is_blamed_on_the_logs_rate(share):
    """Of a vehicle that turns and answers, "it is not excited" sent its pilot to fly more, at the same rate."""
    replicates = np.zeros((3, GAINS + 2))
    span = SimpleNamespace(time=np.arange(0.0, 60.0))
    axis = _Axis(
        data=SimpleNamespace(square=False, axis=0, stretches=[span]), theta=replicates[0], replicates=replicates,
        unexplained=1.0, filled=share, curves=SimpleNamespace(corner=lambda: 1.0, r_squared=lambda _: 0.27),
    )  # fmt: skip
    said = _advise(axis, "set SDLOG_PROFILE 17")
    assert _widening(share) == (1.65 if share < 0.4 else 1.3)  # 92 % of ArduPilot's default logs held the truth
    assert ("roll is not identified, as the log is too slow: of what" in said) is (share < 0.4)
    assert said.endswith("set SDLOG_PROFILE 17 and fly again" if share < 0.4 else "for 30 s; set SDLOG_PROFILE 17")


def test_noise_that_a_filter_took_away_is_not_told_as_a_bound_of_the_search(brief):
    smooth = savgol_filter(brief.gyro.values, 25, 3, axis=0)
    found = identify(replace(brief, gyro=LogSignal(time=brief.gyro.time, values=smooth)))
    assert [axis.noise for axis in found.axes] == [None] * 3
    assert any(line.startswith("gyro noise: not told of roll, pitch, yaw") for line in found.findings)
    assert all(axis.noise is not None for axis in identify(brief).axes)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_signal_of_less_than_two_samples_is_none(brief, count):
    few = LogSignal(time=brief.gyro.time[:count], values=brief.gyro.values[:count])
    log = replace(brief, system="px4", parameters={"IMU_DGYRO_CUTOFF": 30.0, "IMU_GYRO_CUTOFF": 40.0}, command=few)
    log, short = replace(log, motors=few), replace(brief, airborne=((0.0, 8.0),))
    with pytest.raises(ConfigError, match="too short" if count == 2 else "neither torque commands nor motor outputs"):
        identify(log)
    for few_or_none in ({"rate_reference": few}, {"reference": few}, {"attitude": few}):
        absent = dict.fromkeys(few_or_none)
        whole = replace(short, rate_reference=brief.gyro, reference=brief.gyro, attitude=brief.gyro)
        assert (flown_steps(replace(whole, **few_or_none))[1] == flown_steps(replace(whole, **absent))[1]) is (
            count < 2
        )
    assert (filter_command(log) is log) is (count < 2)
    assert fill_command(log) is None


def test_a_rate_that_never_changes_is_explained_by_nothing():
    still = [np.ones(800)]
    curves = Curves(command=still, rate=still, caused=still, time=[np.arange(800) * 0.004], damping=0.0, dt=0.004)
    assert curves.r_squared(40.0) == 0.0


@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e6])  # a gain has the unit of its command
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, True),
        ({"spread": 0.29}, True),
        ({"spread": 0.31}, False),
        ({"evidence": 9.0, "spread": 0.09}, True),
        ({"evidence": 9.0, "spread": 0.11}, False),
        ({"evidence": 0.0}, False),
        ({"damping": 9.9}, True),
        ({"damping": 10.1}, False),
        ({"damping": 0.0, "pulled": -1.9}, True),
        ({"damping": 0.0, "pulled": -2.1}, False),  # a tumbling vehicle was told with -25 1/s
        ({"outruns": 0.036}, False),  # of a yaw of a real 5-inch: four times its gain below 20 rad/s
        ({"sign": -1.0}, False),
        ({"sign": -1.0, "square": True}, True),
        ({"sign": 0.0}, False),
        ({"lag": np.log(0.001)}, True),  # a simulator without a lag
        ({"lag": np.log(0.001), "filled": 0.9}, False),  # a vehicle of 128 ms, logged at 50 Hz, was told as 1 ms
        (
            {"filled": 0.9, "spread": 0.38},
            True,
        ),  # its interval is wider by 1.3: so were those of PX4's default logs
        ({"filled": 0.9, "spread": 0.4}, False),
        ({"lag": np.log(0.4)}, False),
        ({"delay": 0.029}, True),
        ({"delay": 0.031}, False),
        ({"surprise": 3.9, "scale": 0.5}, True),
        ({"surprise": 4.1}, False),
        ({"scale": 0.39}, False),
        ({"scale": 2.6}, False),
    ],
)
def test_a_gain_is_told_by_its_relative_spread_whatever_its_unit(gain, changes, told):
    given = {"spread": 0.0, "evidence": 11.0, "damping": 0.5, "sign": 1.0, "square": False, "lag": -3.0, "delay": 0.01}
    given |= {"surprise": 1.0, "scale": 1.0, "filled": None, "pulled": 0.0, "outruns": 0.0, **changes}
    theta = np.zeros(GAINS + 2)  # one channel, and the trim
    theta[LAG], theta[DAMPING], theta[GAINS] = given["lag"], given["damping"], given["sign"] * gain
    theta[DELAY] = given["delay"]
    replicates = np.tile(theta, (41, 1))
    replicates[:, DAMPING] += given["pulled"]
    replicates[:, GAINS] *= 1.0 + given["spread"] / 0.95 * np.linspace(-1.0, 1.0, 41)  # their 95 % are the spread
    curves = SimpleNamespace(corner=lambda: 1.0, r_squared=lambda _: 0.9)
    axis = _Axis(
        data=SimpleNamespace(square=given["square"]),
        theta=theta, replicates=replicates, unexplained=0.0, curves=curves,
        held_out=SimpleNamespace(**{name: given[name] for name in ("surprise", "scale", "evidence")}),
        filled=given["filled"], outruns=given["outruns"],
    )  # fmt: skip
    assert (axis.gain is not None) == told
    assert ("other sign" in axis.doubt) == (not given["square"] and given["sign"] <= 0.0)
    if told:  # within what it is drawn with, and the hundredth that the model leaves out
        assert axis.gain.high / axis.gain.nominal - 1.0 == pytest.approx(np.hypot(given["spread"], 0.01), rel=1e-3)


@pytest.mark.parametrize(
    ("evidence", "trades", "told"),
    [
        (
            99.0,
            True,
            "roll is not excited: the command explains 0 % of its acceleration, its gain is known to 50 % only",
        ),
        (400.0, False, "roll is not identified: its gain is known to 50 % only, though it acts on the rate. Fly"),
        (400.0, True, "it trades off with the lag, their ratio is known to"),
    ],
)
def test_a_loose_gain_of_a_command_that_acts_is_not_called_unexcited(evidence, trades, told):
    """Two flights of real quads at a coherence of .9 were told so: R^2 is below 0 where the command answers gusts."""
    theta, spread = np.zeros(GAINS + 2), 0.5 / 0.95 * np.linspace(-1.0, 1.0, 41)
    theta[LAG], theta[GAINS] = np.log(0.02), 1000.0
    replicates = np.tile(theta, (41, 1))
    replicates[:, GAINS] *= 1.0 + spread
    replicates[:, LAG] += np.log1p(spread) * trades
    axis = _Axis(
        data=SimpleNamespace(square=False, axis=0, stretches=[]), theta=theta, replicates=replicates, unexplained=0.0,
        curves=SimpleNamespace(corner=lambda: 1.0, r_squared=lambda _: -2.9),
        held_out=SimpleNamespace(surprise=1.0, scale=1.0, evidence=evidence),
    )  # fmt: skip
    assert axis.gain is None
    assert told in _advise(axis, "log more")


@pytest.mark.parametrize(
    ("changes", "is_filled", "wider"),
    [
        ({}, True, None),
        ({LAG: np.log(0.001)}, True, 0.008),  # eight of ten such logs are told with one sample in 8 or 16 ms
        ({LAG: np.log(0.001)}, False, None),
        ({LAG: np.log(0.4)}, False, 0.008),
    ],
)
def test_a_lag_at_an_end_of_its_search_asks_for_wider_spacing(changes, is_filled, wider):
    theta = np.zeros(GAINS + 2)
    theta[LAG], theta[DELAY] = np.log(0.05), 0.005
    for place, value in changes.items():
        theta[place] = value
    axes = [SimpleNamespace(theta=theta, is_noise_gone=False, likeness=-0.2) for _ in range(3)]
    gyro = LogSignal(time=np.arange(100) * 0.004, values=np.zeros((100, 3)))
    assert _next_spacing(axes, gyro, is_filled=is_filled) == wider
