import numpy as np
import pytest

from firmware_model.autopilot.modes import Mode
from firmware_model.config.vehicle import load_vehicle
from gustproof.show.report.html.charts import CurveStyle, spectra, time_histories
from gustproof.show.report.html.runs import read_runs
from gustproof.show.report.thinned import decimate

N = 500
TIME = 0.004 * np.arange(N)


def noise(seed, columns=3, n=N):
    return np.random.default_rng(seed).standard_normal((n, columns))


def titles(groups):
    return [group.title for group in groups]


def test_only_what_something_happens_in_is_shown(recorded):
    runs = read_runs([recorded("run", n=N, omega_B=noise(1))])
    assert titles(time_histories(runs)) == ["Body rates"]
    limit = load_vehicle("paper").torque_limit
    runs = read_runs([recorded("more", n=N, omega_B=noise(1), torque_command_B=noise(2), rotors=noise(3, 4))])
    assert titles(time_histories(runs)) == ["Body rates", "Commanded torque", "Saturation", "Thrust of the rotors"]
    share = time_histories(runs)[2].charts[0].curves[0].y
    assert share == pytest.approx(np.max(np.abs(noise(2)) / limit, axis=1))


def test_rates_that_were_commanded_for_a_time_are_shown_for_that_time(recorded):
    commanded = noise(1)
    commanded[: N // 2] = np.nan
    runs = read_runs([recorded("asked", n=N, omega_command_B=commanded), recorded("unasked", n=N)])
    (group,) = (group for group in time_histories(runs) if group.title == "Commanded rates")
    for k, chart in enumerate(group.charts):
        (curve,) = chart.curves
        assert np.array_equal(curve.y, np.degrees(commanded[:, k]), equal_nan=True)


def test_the_age_of_commands_is_shown_with_its_gaps(recorded):
    age = np.where(np.arange(N) // 100 % 2, np.nan, 3.0)[:, np.newaxis]
    (group,) = time_histories(read_runs([recorded("run", n=N, command_age=age)]))
    assert group.title == "Link"
    assert np.array_equal(group.charts[0].curves[0].y, age[:, 0], equal_nan=True)


def test_modes_are_named_and_drawn_by_their_places(recorded):
    mode = np.repeat([Mode.OFFBOARD.value, Mode.HOLD.value, 17.0], (100, 200, N - 300))
    (group,) = time_histories(read_runs([recorded("run", n=N, mode=mode)]))
    (chart,) = group.charts
    assert (group.title, chart.title) == ("Autopilot", "mode: 0 number 17, 1 OFFBOARD, 2 HOLD")
    assert np.array_equal(chart.curves[0].y, np.repeat([1.0, 2.0, 0.0], (100, 200, N - 300)))


@pytest.mark.slow
def test_an_attitude_that_is_asked_for_is_drawn_dashed_with_the_one_that_is_flown(recorded):
    """The scenario asks for 10 degrees of roll from 2 s on, and of pitch instead from 9 s on."""
    n, time = 2500, 0.004 * np.arange(2500)
    turning = np.column_stack((np.cos(0.1 * time), np.sin(0.1 * time), 0.0 * time, 0.0 * time))
    script = {"n": n, "scenario": "attitude-steps"}
    one, other = (recorded(law, law=law, q_NB=turning, **script) for law in ("pid-fair", "hinf-d1"))
    for paths in ([one], [one, other]):
        charts = time_histories(read_runs(paths))[0].charts
        for chart, angles in zip(charts, ([0.0, 10.0, 0.0], [0.0, 0.0, 10.0], [0.0, 0.0, 0.0]), strict=True):
            flown, asked = chart.curves
            assert (flown.style, asked.style, asked.label) == (CurveStyle.SOLID, CurveStyle.DASHED, "reference")
            assert asked.y == pytest.approx(np.repeat(angles, (500, 1750, n - 2250)))
    script["n"] = n - 500
    shorter = recorded("shorter", law="hinf-d1", q_NB=turning[:-500], **script)
    curves = time_histories(read_runs([one, shorter]))[0].charts[0].curves
    assert [curve.label for curve in curves[-2:]] == ["reference of pid-fair", "reference of hinf-d1"]


def test_what_all_flights_share_is_drawn_once(recorded):
    gust, other = noise(1), noise(2)
    same = read_runs([recorded("a", n=N, gust_B=gust), recorded("b", n=N, law="pid-fair", gust_B=gust)])
    assert [curve.label for curve in time_histories(same)[0].charts[0].curves] == ["all runs"]
    apart = read_runs([recorded("c", n=N, gust_B=gust), recorded("d", n=N, law="pid-fair", gust_B=other)])
    assert {curve.label for curve in time_histories(apart)[0].charts[0].curves} == {"hinf-d1", "pid-fair"}


def test_the_calmest_flight_is_drawn_on_top(recorded):
    runs = read_runs([recorded("calm", n=N, omega_B=0.1 * noise(1)), recorded("rough", n=N, seed=2, omega_B=noise(2))])
    assert [curve.colour for curve in time_histories(runs)[0].charts[0].curves] == [1, 0]


def test_a_thinned_curve_keeps_every_stretch_s_extremes_in_order():
    values = np.random.default_rng(3).standard_normal(10_000)
    time, shown = decimate(np.arange(10_000.0), values, most=100)
    assert len(time) <= 100
    assert np.all(np.diff(time) > 0.0)
    assert np.array_equal(shown, values[time.astype(int)])
    for stretch in np.split(np.arange(10_000), 50):
        kept = shown[(time >= stretch[0]) & (time <= stretch[-1])]
        assert (kept.min(), kept.max()) == (values[stretch].min(), values[stretch].max())


def test_a_short_curve_is_drawn_whole():
    time, shown = decimate(TIME, TIME**2)
    assert time is TIME
    assert np.array_equal(shown, TIME**2)


def test_the_spectrum_s_area_is_the_variance_and_its_peak_the_frequency(recorded):
    gust = noise(5, n=4000) * [1.0, 2.0, 3.0]
    gust[:, 1] += 4.0 * np.sin(50.0 * 0.004 * np.arange(4000))
    (group,) = spectra(read_runs([recorded("run", n=4000, gust_B=gust)]))
    for k, chart in enumerate(group.charts):
        (curve,) = chart.curves
        step = curve.x[1] - curve.x[0]
        # Welch's windows weigh the samples unevenly: seven spectra of 1000 samples
        assert np.sum(curve.y) * step == pytest.approx(np.var(gust[:, k]), rel=0.1)
    peak = group.charts[1].curves[0]
    assert peak.x[np.argmax(peak.y)] == pytest.approx(50.0, abs=peak.x[1] - peak.x[0])
    assert group.charts[0].title == "forward u [(m/s)²/(rad/s)]"


def test_a_rotor_has_a_chart_with_the_runs_whose_vehicles_have_it(recorded):
    thrusts = np.outer(np.arange(N), np.arange(1.0, 9.0))
    paths = [recorded("quad", n=N, rotors=thrusts[:, :4]), recorded("octo", n=N, seed=2, rotors=thrusts)]
    (group,) = time_histories(read_runs(paths))
    assert [len(chart.curves) for chart in group.charts] == [1, 1, 1, 1, 1, 1, 1, 1]
    assert group.charts[0].curves[0].label == "all runs"
    assert np.array_equal(group.charts[7].curves[0].y, thrusts[:, 7])


def test_a_chart_without_a_curve_is_left_out(recorded):
    gust, asked = noise(1), noise(2)
    gust[:, [0, 2]], asked[:, 1] = 0.0, np.nan  # from the side alone; no pitch rate
    runs = read_runs([recorded("run", n=N, gust_B=gust, omega_command_B=asked)])
    groups = {group.title: [chart.title for chart in group.charts] for group in (*time_histories(runs), *spectra(runs))}
    assert groups["Spectrum: gust"] == ["right v [(m/s)²/(rad/s)]"]
    assert groups["Commanded rates"] == ["p [deg/s]", "r [deg/s]"]
    assert groups["Gust, blowing toward"] == ["right v [m/s]"]
    (note,) = (group.note for group in time_histories(runs) if group.title == "Gust, blowing toward")
    assert note == "Constant, not drawn: forward u 0, down w 0."
