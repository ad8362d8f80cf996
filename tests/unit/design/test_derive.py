"""Laws derived from designs: known margins, a report that says what it must, shipped files that are what they claim."""

import dataclasses
import json
import math

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from gustproof.design.derive import DesignReport, derive
from gustproof.design.designs import Design, list_designs, load_design
from gustproof.law.form import Law, Output, list_laws, load_law

SAME = 1e-9
"""Relative to the largest entry: what another BLAS may change."""


@pytest.fixture(scope="module", params=list_designs())
def derived(request) -> tuple[Design, Law, DesignReport]:
    design = load_design(request.param)
    return design, *derive(design)


@pytest.mark.slow
def test_the_shipped_law_is_the_one_derived_from_the_design(derived):
    design, law, _ = derived
    shipped = load_law(design.law)
    for name in ("A", "B", "C", "D", "G", "H", "limits"):
        ours, theirs = getattr(law, name), getattr(shipped, name)
        assert np.allclose(ours, theirs, rtol=SAME, atol=SAME * max(np.max(np.abs(theirs)), 1e-300)), name
        assert np.array_equal(ours != 0.0, theirs != 0.0), name
    assert shipped.provenance.parameters == pytest.approx(law.provenance.parameters, rel=1e-6)  # gamma_opt: 1e-7
    assert (shipped.name, shipped.dt, shipped.output) == (law.name, law.dt, law.output)
    assert (shipped.is_scheduled, shipped.provenance.design) == (law.is_scheduled, law.provenance.design)


@pytest.mark.parametrize("name", list_laws())
def test_no_coefficient_of_a_shipped_law_couples_its_axes(name):
    law = load_law(name)
    n, measured = law.order, law.B.shape[1]
    edges = np.zeros((n + measured + 3,) * 2, dtype=bool)  # among states, measurements and commands
    x, y, u = slice(n), slice(n, n + measured), slice(n + measured, n + measured + 3)
    edges[x, x], edges[x, y], edges[u, x], edges[u, y] = law.A, law.B, law.C, law.D
    edges[x, 3:6] |= law.G != 0.0
    edges[x, u] |= law.H != 0.0
    if (limit := law.rate_limit) is not None:
        for matrix in (limit.S, limit.T[:, :3], limit.T[:, 3:6], limit.U):
            assert not matrix[:, :3][~np.eye(3, dtype=bool)].any()
    axis = connected_components(edges, directed=False)[1]
    commands = axis[u].tolist()
    assert len(set(commands)) == 3
    assert axis[y][:3].tolist() == commands
    used = (law.B != 0.0).any(axis=0) | (law.D != 0.0).any(axis=0)
    # references, and roll and pitch by gravity, are of their own axis
    for k, own in zip(range(3, measured), (0, 1, 2, 0, 1), strict=False):
        assert not used[k] or axis[y][k] == commands[own], k


@pytest.mark.parametrize(
    ("name", "states"), [("hinf-scheduled", (3, 3, 3)), ("hinf-d2", (3, 3, 3)), ("aided", (6, 6, 4))]
)
def test_a_law_has_no_more_coefficients_than_its_axes_need(name, states):
    law = load_law(name)
    assert np.count_nonzero(law.A) == sum(n**2 for n in states)
    assert np.count_nonzero(law.C) == sum(states)
    assert np.count_nonzero(law.G) == sum(states) * law.is_scheduled


def test_every_shipped_law_meets_its_level_and_survives_its_sample_time_and_delay(derived):
    design, law, report = derived
    assert report.result.norm < report.result.gamma == design.gamma
    assert law.order == report.result.order
    assert all(loop.Ms < 3.0 for loop in report.sampled.input)
    assert all(late.delay_margin < loop.delay_margin for late, loop in
               zip(report.sampled.input, report.continuous.input, strict=True))  # fmt: skip


@pytest.mark.parametrize(
    ("name", "crossover", "phase_deg", "delay_ms", "Ms"),
    [("D1", 9.5, 64.0, 117.0, 1.21), ("D2", 16.4, 65.0, 70.0, 1.20), ("D5", 27.9, 38.5, 24.0, 1.63)],
)
def test_the_roll_loop_has_the_known_margins(name, crossover, phase_deg, delay_ms, Ms):
    _, report = derive(load_design(name))
    roll = report.continuous.input[0]
    assert roll.crossover == pytest.approx(crossover, rel=0.02)
    assert math.degrees(roll.phase_margin) == pytest.approx(phase_deg, abs=0.6)
    assert roll.delay_margin * 1e3 == pytest.approx(delay_ms, rel=0.02)
    assert roll.Ms == pytest.approx(Ms, abs=0.006)


def test_the_report_is_json_and_says_what_a_designer_asks(derived):
    _, _, report = derived
    document = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert document["norm"] < document["gamma"]
    assert document["gamma_opt"] < document["gamma"]
    assert len(document["poles_rad_s"]) == document["order"]
    assert set(document["continuous"]["input"]) == {"disk_margin", "roll", "pitch", "yaw"}


def test_no_singular_value_of_the_closed_loop_is_above_the_norm(derived):
    _, _, report = derived
    curves = report.singular_values(np.geomspace(1e-3, 1e3, 60))
    assert np.max(curves["w to z"]) <= report.result.norm * (1.0 + 1e-8)
    assert np.max(curves["S, plant input"]) <= 1.0 / report.continuous.input_disk + 0.5 + 1e-6
    assert curves["T, plant input"][0] == pytest.approx(1.0, abs=0.01)


def test_a_law_for_rates_commands_rates():
    law, report = derive(load_design("R1"))
    assert law.output is Output.RATES
    assert np.allclose(law.limits, 3.0)
    assert report.result.order == 6


def test_a_reference_is_followed_quickly_and_held_by_a_vehicle_without_leak():
    _, report = derive(load_design("reference"))
    assert report.step is not None
    figures = report.step.step_info()
    assert figures.rise_time_s < 0.5
    assert figures.overshoot < 0.02
    assert figures.settling_time_s < 0.7
    assert figures.final_error < 0.025


def test_the_step_is_part_of_the_report():
    _, report = derive(load_design("reference"))
    assert set(report.to_dict()["step"]) == {"rise_time_s", "overshoot", "settling_time_s", "final_error"}


def test_another_vehicle_gives_another_law():
    paper, _ = derive(load_design("D1"))
    iris, report = derive(dataclasses.replace(load_design("D1"), vehicle="iris", gamma=None))
    assert report.vehicle == "iris"
    assert not np.allclose(paper.C, iris.C)


def test_provenance_names_the_damping_of_the_model():
    design = dataclasses.replace(load_design("D1"), gamma=None)
    damped = [
        law.provenance.parameters
        for law, _ in (derive(design), derive(dataclasses.replace(design, vehicle="iris", rate_damping=None)))
    ]
    assert damped[0]["rate_damping_per_s"] == 0.02
    names = [f"rate_damping_per_s_{axis}" for axis in ("roll", "pitch", "yaw")]
    assert tuple(damped[1][name] for name in names) == pytest.approx((0.845, 0.323, 0.616), abs=1e-3)
    assert "rate_damping_per_s" not in damped[1]
