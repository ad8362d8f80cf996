from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.physics.dryden import dryden_spectrum
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law
from gustproof.logs.identify.air import (
    ALTITUDE_M,
    Grid,
    _dryden,
    _smooth,
    _step,
    estimate_air,
    replay_text,
    turbulence_density,
    turbulence_scenario,
)
from gustproof.logs.identify.identification import Interval
from gustproof.logs.read.flight_log import FlightLog, LogSignal

IRIS = load_vehicle("iris")


def decibels(ratio):
    return 20.0 * np.log10(ratio)


def fly(wind=15.0, seed=1, vehicle=IRIS, scenario="paper-turbulence"):
    script = load_scenario(scenario)
    if scenario == "paper-turbulence":
        script = replace(script, wind=(replace(script.wind[0], wind_speed_20ft_mps=wind),))
    return fly_direct(script, load_law("pid-fair"), vehicle=vehicle, seed=seed)


def disturbance(records, vehicle=IRIS):
    """Return the true disturbance [rad/s^2], of gusts and angular gusts, without its mean."""
    found = records["moment_B"] / vehicle.inertia_B + np.array(vehicle.rate_damping_B) * records["gust_omega_B"]
    return found - found.mean(axis=0)


def test_the_density_of_the_moments_holds_the_specification_s_variance():
    bare = replace(IRIS, rate_damping=0.0)
    omega = np.geomspace(1e-4, 1e4, 20_000)
    variance = np.trapezoid(turbulence_density(omega, bare, 5.0, 0.4), omega, axis=1)
    s = dryden_spectrum(_dryden(1.0, 5.0), ALTITUDE_M, bare.span)
    expected = np.array([s.sigma_v, s.sigma_u, 0.4 * s.sigma_w]) * bare.gust_gain / bare.inertia_B
    assert np.sqrt(variance) == pytest.approx(expected, rel=2e-3)


def test_the_densities_are_those_of_the_specification_at_each_frequency():
    """MIL-F-8785C, 3.7.1.2: densities [(m/s)^2 m] of linear gusts over Omega [rad/m], and of angular ones."""
    airspeed, omega, damping = 5.0, np.array([0.1, 1.0, 10.0]), 2.0
    s, span, Omega = dryden_spectrum(_dryden(1.0, airspeed), ALTITUDE_M, IRIS.span), IRIS.span, omega / airspeed

    def transverse(sigma, L):
        return sigma**2 * L / np.pi * (1.0 + 3.0 * (L * Omega) ** 2) / (1.0 + (L * Omega) ** 2) ** 2

    along = s.sigma_u**2 * 2.0 * s.L_u / np.pi / (1.0 + (s.L_u * Omega) ** 2)
    across, vertical = transverse(s.sigma_v, s.L_v), transverse(s.sigma_w, s.L_w)
    wide = 1.0 + (4.0 * span * Omega / np.pi) ** 2
    roll = s.sigma_w**2 / s.L_w * 0.8 * (np.pi * s.L_w / (4.0 * span)) ** (1.0 / 3.0) / wide
    yaw = Omega**2 * across / (1.0 + (3.0 * span * Omega / np.pi) ** 2)
    gain = IRIS.gust_gain / np.array(IRIS.inertia_B) * (1.0, 1.0, 0.4)
    gusts, turning = np.array([across, along, vertical]), np.array([roll, Omega**2 * vertical / wide, yaw])
    expected = (gain[:, None] ** 2 * gusts + damping**2 * turning) / airspeed
    damped = replace(IRIS, rate_damping=damping)
    np.testing.assert_allclose(turbulence_density(omega, damped, airspeed, 0.4), expected, rtol=1e-9)


def test_the_smoother_is_the_conditional_mean_of_gaussian_signals():
    """Compare with dense covariances: m a first-order noise, the first rate unknown."""
    n, dt, sigma, kept, a, power = 60, 0.01, 2.0, 0.9, 0.97, 1e-4
    b, rng = dt * 0.98, np.random.default_rng(1)
    count = rng.integers(0, 3, n).astype(float)
    force, y = rng.standard_normal(n), 0.1 * rng.standard_normal(n)
    grid = Grid(
        time=dt * np.arange(n),
        gyro=np.tile(y[:, None], 3),
        count=count,
        drive=np.tile(force[:, None], 3),
    )
    found = _smooth(grid, 0, (a, b), (sigma, kept), power)
    trim = ((y[1:] - a * y[:-1]) / b - force[:-1]).mean()
    lags = np.abs(np.subtract.outer(np.arange(n - 1), np.arange(n - 1)))
    P = sigma**2 * kept**lags
    step = np.array([[b * a ** (k - 1 - j) if j < k else 0.0 for j in range(n - 1)] for k in range(n)])
    first = a ** np.arange(n)
    rate = count.sum() / (dt * (n - 1))
    seen = count > 0
    noise = np.diag(power * rate / 2.0 / count[seen])
    cov = step[seen] @ P @ step[seen].T + 1e6 * np.outer(first[seen], first[seen]) + noise
    expected = P @ step[seen].T @ np.linalg.solve(cov, y[seen] - step[seen] @ (force[:-1] + trim))
    assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("damping", "expected"), [(0.0, (1.0, 0.5)), (2.0, (np.exp(-1.0), (1.0 - np.exp(-1.0)) / 2.0))]
)
def test_a_step_is_exact_for_a_held_acceleration_with_and_without_damping(damping, expected):
    assert _step(damping, 0.5) == pytest.approx(expected)


def test_the_disturbance_of_a_flight_is_found(perfect, log_of):
    records = fly()
    log = log_of(records)
    air = estimate_air(log, perfect(IRIS), IRIS)
    late = {name: replace(each, time=each.time + 7.0) for name in ("gyro", "command") if (each := getattr(log, name))}
    aloft = tuple((begin + 7.0, end + 7.0) for begin, end in log.airborne)
    assert estimate_air(replace(log, airborne=aloft, **late), perfect(IRIS), IRIS).time == pytest.approx(air.time)
    truth = disturbance(records)[np.rint(air.time / 0.004).astype(int)]
    assert air.acceleration.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.all(np.abs(decibels(air.acceleration.std(axis=0) / truth.std(axis=0))) < 2.0)
    found = air.wind_speed_20ft, air.airspeed, air.yaw_ratio, len(air.omega)
    np.testing.assert_allclose(found, (15.03683, 13.06677, 0.3538598, 1699), rtol=1e-3)  # by priors and segments
    for k, least in enumerate((0.95, 0.98, 0.85)):
        assert np.corrcoef(air.acceleration[:, k], truth[:, k])[0, 1] > least


def test_a_disturbance_that_is_no_turbulence_tells_no_air(perfect, log_of):
    """In PX4's own simulator, without wind, what the model lacks was once turbulence at 500 m/s."""
    records = fly(wind=0.5).copy()
    assert estimate_air(log_of(records), perfect(IRIS), IRIS).doubt == ""
    noise = np.random.default_rng(1).standard_normal(records["gyro_B"].shape)
    records["gyro_B"] += 0.02 * lfilter(*butter(2, 3.0, fs=250.0), noise, axis=0)
    with pytest.raises(ConfigError, match="ends at a bound of the search"):
        estimate_air(log_of(records), perfect(IRIS), IRIS)


@pytest.mark.slow
@pytest.mark.parametrize(("airspeed", "told"), [(3.0, "slower"), (10.0, ""), (59.0, "quicker")])
def test_gusts_that_pass_at_another_speed_than_the_wind_are_doubted(perfect, log_of, airspeed, told):
    air = estimate_air(log_of(fly()), perfect(IRIS), IRIS)
    assert told in replace(air, wind_speed_20ft=12.0, airspeed=airspeed).doubt
    assert bool(replace(air, wind_speed_20ft=12.0, airspeed=airspeed).doubt) == bool(told)


@pytest.mark.slow
def test_lost_samples_change_little(perfect, log_of):
    records = fly()
    log = log_of(records)
    kept = np.random.default_rng(3).random(len(records)) > 0.1
    gappy = replace(log, gyro=LogSignal(time=log.gyro.time[kept], values=log.gyro.values[kept]))
    whole, air = (estimate_air(each, perfect(IRIS), IRIS) for each in (log, gappy))
    assert abs(decibels(air.wind_speed_20ft / whole.wind_speed_20ft)) < 0.3
    n = min(len(air.time), len(whole.time))
    assert np.corrcoef(air.acceleration[:n, 0], whole.acceleration[:n, 0])[0, 1] > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("wind", [4.0, 15.0])
def test_the_wind_of_turbulence_is_found_within_two_decibels(perfect, log_of, wind):
    found = [estimate_air(log_of(fly(wind, seed)), perfect(IRIS), IRIS) for seed in range(1, 6)]
    assert max(abs(decibels(air.wind_speed_20ft / wind)) for air in found) < 2.0
    assert np.median([air.airspeed for air in found]) == pytest.approx(wind, rel=0.3)
    assert np.median([air.yaw_ratio for air in found]) == pytest.approx(IRIS.gust_yaw_ratio, rel=0.5)


@pytest.mark.slow
def test_the_wind_file_replays_the_moments(perfect, log_of, tmp_path):
    records, found = fly(), perfect(IRIS)
    air = estimate_air(log_of(records), found, IRIS)
    (tmp_path / "wind.csv").write_text(replay_text(air, IRIS))
    day = 'description = "again"\nduration_s = 59.0\n[[wind]]\nkind = "replay"\nfile = "wind.csv"\n'
    (tmp_path / "day.toml").write_text(day)
    again = fly(seed=9, scenario=tmp_path / "day.toml")
    ratio = disturbance(again).std(axis=0) / disturbance(records).std(axis=0)
    assert np.all(np.abs(decibels(ratio)) < 2.0)
    assert np.corrcoef(*(each["moment_B"][500:14000, 1] for each in (again, records)))[0, 1] > 0.98


def test_the_scenario_has_the_turbulence_and_the_delay(perfect, log_of):
    found = replace(perfect(IRIS), delay=Interval(0.007, 0.008, 0.009))
    air = estimate_air(log_of(fly()), found, IRIS)
    scenario = turbulence_scenario("gust", air, found)
    (wind,) = scenario.wind
    assert (wind.wind_speed_20ft, wind.airspeed) == (air.wind_speed_20ft, air.airspeed)
    assert scenario.delay_samples == 3


@pytest.mark.slow
def test_motors_explain_what_torques_do(perfect, log_of):
    """Give the same commands as speeds of two motors whose thrust difference is the torque."""
    records = fly()
    log, found = log_of(records), perfect(IRIS)
    share = 0.5 + 0.2 * np.clip(records["torque_command_B"][:, 1], -1.0, 1.0)
    motors = np.sqrt(np.stack([share, 1.0 - share], axis=1))
    gains = np.zeros((3, 2))
    gains[1] = np.array([1.0, -1.0]) / (0.4 * IRIS.inertia_B[1])
    axes = tuple(
        axis if k == 1 else replace(axis, gain=None, advice="fly a chirp") for k, axis in enumerate(found.axes)
    )
    told = replace(found, axes=axes, motor_gains=gains)
    by_motors = estimate_air(
        replace(log, command=None, motors=LogSignal(time=log.gyro.time, values=motors)), told, IRIS
    )
    assert by_motors.yaw_ratio is None
    assert np.all(by_motors.acceleration[:, 0] == 0.0)
    by_torque = estimate_air(log, found, IRIS)
    assert np.corrcoef(by_motors.acceleration[:, 1], by_torque.acceleration[:, 1])[0, 1] > 0.999


def test_a_log_that_tells_no_air_is_refused_in_one_line(perfect):
    found = perfect(IRIS)
    time = np.arange(0.0, 2.0, 0.004)
    still = LogSignal(time=time, values=np.zeros((len(time), 3)))
    log = FlightLog(source="short.csv", system="csv", gyro=still, command=still)
    with pytest.raises(ConfigError, match="no 5 s in the air"):
        estimate_air(log, found, IRIS)
    silent = replace(found, axes=tuple(replace(axis, gain=None, advice="fly a chirp") for axis in found.axes))
    with pytest.raises(ConfigError, match="neither roll nor pitch"):
        estimate_air(log, silent, IRIS)
