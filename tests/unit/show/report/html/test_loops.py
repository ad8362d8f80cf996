from dataclasses import replace

import numpy as np
import pytest

from gustproof.law.form import load_law
from gustproof.show.report.html.charts import ChartKind, CurveStyle
from gustproof.show.report.html.loops import collect_laws, frequency_charts, pole_charts
from gustproof.show.report.html.runs import read_runs


@pytest.fixture
def laws(recorded):
    """Give the laws of one run each, by name."""
    return lambda *names: collect_laws(read_runs([recorded(name, law=name, n=2) for name in names]))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hinf-d1", "hinf-rates", "hinf-d1-noise"])
def test_a_design_keeps_below_the_bounds_that_its_weights_set(laws, name):
    found = laws(name)
    group = frequency_charts(found)[-1]
    assert group.title == f"Singular values against the weights: {name}"
    for chart in group.charts[:-1]:
        bounds = [curve.y for curve in chart.curves if curve.style is CurveStyle.DASHED]
        gains = [curve.y for curve in chart.curves if curve.style is CurveStyle.SOLID]
        assert len(gains) == 3
        for bound, gain in zip(bounds if len(bounds) == 3 else 3 * bounds, gains, strict=True):
            assert np.all(gain <= bound)
    # the largest of all is the norm that was designed; a weight's floor makes it nearly touch the level
    result = found[0].design.result
    assert np.max(group.charts[-1].curves[-1].y) == pytest.approx(result.norm, rel=2e-3)


def test_pid_has_no_weights_and_a_law_that_was_changed_no_longer_has(laws, recorded):
    (pid,) = laws("pid-fair")
    assert pid.design is None
    (run,) = read_runs([recorded("run", law="hinf-d1", n=2)])
    law = load_law("hinf-d1")
    assert collect_laws([run])[0].design is not None
    assert collect_laws([replace(run, controller=replace(law, C=1.001 * law.C))])[0].design is None
    elsewhere = replace(law.provenance, vehicle="nobody's")
    assert collect_laws([replace(run, controller=replace(law, provenance=elsewhere))])[0].design is None


def test_sensitivities_are_shown_of_every_torque_loop(laws):
    group = frequency_charts(laws("pid-fair", "pid-default"))[0]
    assert [[curve.label for curve in chart.curves] for chart in group.charts] == 3 * [["pid-fair", "pid-default"]]
    S, linear = group.charts[0].curves[0], group.charts[1]
    peak = 10.0 ** (np.nanmax(S.y) / 20.0)
    assert peak == pytest.approx(1.36, rel=1e-2)  # the sensitivity peak that pid-fair is made for
    assert np.nanmin(S.y) > -40.0  # dB
    assert (linear.kind, np.nanmax(linear.curves[0].y)) == (ChartKind.SEMILOG, pytest.approx(peak))
    dot = linear.marks[0]
    assert (dot.label, dot.y) == (f"{peak:.2f}", pytest.approx(peak))
    assert dot.x == (pytest.approx(S.x[np.nanargmax(S.y)]),) * 2


def test_a_law_that_flew_twice_is_shown_once(recorded):
    runs = read_runs([recorded("a", n=2), recorded("b", seed=2, n=2)])
    assert [law.label for law in collect_laws(runs)] == ["hinf-d1, seed 1"]


def test_poles_are_those_of_the_law_and_of_a_stable_loop(laws):
    (chart,) = pole_charts(laws("pid-default"))[0].charts
    loop, law = chart.curves
    assert np.all(loop.x < 0.0)
    assert np.count_nonzero(np.abs(law.x) < 1e-6) == 6  # two integrators an axis
