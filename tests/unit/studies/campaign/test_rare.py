"""Rare events: their probability where it is known, and the flights found."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtr

from firmware_model.config.scenario import load_scenario
from firmware_model.errors import ConfigError
from gustproof.flight.routes.batch import fly_many
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.studies.campaign.plan import DispersionKind
from gustproof.studies.campaign.rare import RareEstimate, Threshold, estimate_rare, make_rare_case, parse_threshold
from gustproof.studies.campaign.sampling import Sampling, draw_deltas, draw_normals, place_deltas

GUST = (DispersionKind.GUST,)


@pytest.fixture
def known(monkeypatch):
    """Make each flight's peak a standard normal number of its noise, times a function of its gusts' scale."""
    names = dict.fromkeys(Metrics.__dataclass_fields__, 0.0)

    @cache
    def draw(seed):
        return float(np.random.default_rng(seed).standard_normal())

    def peak(case):
        total = draw(case.seed)
        for turn in case.turns:
            total = math.cos(turn.angle_rad) * total + math.sin(turn.angle_rad) * draw(turn.seed)
        return case.gust_scale * total

    def simulator(*_):
        return lambda cases: [SimpleNamespace(metrics=Metrics(**{**names, "peak_deg": peak(each)})) for each in cases]

    monkeypatch.setattr("gustproof.studies.campaign.rare.make_batch_simulator", simulator)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("peak_deg", "is 'peak_deg', must be a figure and its limit"),
        ("peak_deg < 1", "is 'peak_deg < 1', must be a figure and its limit"),
        ("peak_deg > one", "must be a figure and its limit"),
        ("peak_deg > inf", "must be a figure and its limit"),
        ("peak > 1", "'peak' is none of peak_deg, rmse_deg"),
    ],
)
def test_a_figure_and_its_limit_are_asked_for(text, complaint):
    with pytest.raises(ConfigError, match=complaint):
        parse_threshold(text)
    assert parse_threshold(" rmse_yaw_deg>0.5 ") == Threshold("rmse_yaw_deg", 0.5)


def test_campaigns_that_it_cannot_judge_are_refused(planned, here):
    event = Threshold("peak_deg", 1.0)
    with pytest.raises(ConfigError, match="a rare event is of one law, not 2"):
        estimate_rare(planned(), event, here)
    with pytest.raises(ConfigError, match="uniform or normal, not sobol"):
        estimate_rare(planned(laws=("hinf-d1",), sampling=Sampling.SOBOL), event, here)
    with pytest.raises(ConfigError, match="without link, mode or controller events"):
        estimate_rare(planned(laws=("hinf-d1",), scenario=load_scenario("link-delay")), event, here)


@pytest.mark.parametrize("sampling", [Sampling.UNIFORM, Sampling.NORMAL])
def test_dispersions_are_those_of_a_campaign(sampling):
    placed = [place_deltas(sampling, row) for row in draw_normals(3, 2, 5, 20)]
    np.testing.assert_allclose(placed, draw_deltas(sampling, 3, 100, 2, 5, 20), atol=1e-12)


def test_an_estimate_is_repeated_to_the_bit(planned, here, known, monkeypatch):
    monkeypatch.setattr("gustproof.studies.campaign.rare.ENSEMBLES", 3)
    plan, event = planned(wanted=GUST, laws=("hinf-d1",), cases=1), Threshold("peak_deg", 2.0)
    found, shown = estimate_rare(plan, event, here), []
    assert estimate_rare(plan, event, here, progress=shown.append) == found
    assert shown == pytest.approx([0.25, 0.5, 0.75, 1.0])
    settled = 0.016743978, 0.0106295602, 0.0266369697, 0.6725794377, 1.464299291, 4.268716426
    assert (*found.probability, *found.levels, found.hits[0].value) == pytest.approx(settled)
    assert (found.flights, found.hits[0].turns[-1].angle_rad) == (1453, pytest.approx(0.8679033))
    assert len({hit.seed >> 28 for hit in found.hits}) == 3  # each ensemble has a part of all seeds
    assert estimate_rare(replace(plan, seed=2), event, here).probability != found.probability


@pytest.mark.slow
def test_the_probability_of_a_tail_is_found(planned, here, known):
    plan, shown = planned(wanted=(), laws=("hinf-d1",), cases=1), []
    found = estimate_rare(plan, Threshold("peak_deg", 4.2649), here, progress=shown.append)
    _, low, high = found.probability
    assert low < 1e-5 < high
    assert high / low < 5.0
    assert found.flights < found.plain_flights / 10.0
    assert list(found.levels) == sorted(found.levels)
    assert (shown[-1], shown == sorted(shown)) == (1.0, True)
    document = found.to_dict()
    assert document["interval"] == [low, high]
    assert document["hits"][0]["value"] == max(hit.value for hit in found.hits) > 4.2649


@pytest.mark.slow
def test_dispersions_count_too(planned, here, known):
    plan = planned(wanted=GUST, laws=("hinf-d1",), cases=1)
    scales = np.linspace(0.5, 1.5, 2001)
    expected = float(np.mean(1.0 - ndtr(5.0 / scales)))
    found = estimate_rare(plan, Threshold("peak_deg", 5.0), here)
    assert found.probability.low < expected < found.probability.high
    assert found.probability.high / found.probability.low < 9.0
    assert np.mean([hit.deltas[0] for hit in found.hits]) > 0.5  # strong gusts bring it about


def test_an_event_that_no_level_leads_to_has_a_bound(planned, here, known):
    found = estimate_rare(planned(wanted=(), laws=("hinf-d1",), cases=1), Threshold("rmse_deg", 0.5), here)
    assert (found.probability.value, found.probability.low, found.hits) == (0.0, 0.0, ())
    assert 0.0 < found.probability.high < 0.1
    assert math.isnan(found.plain_flights)
    assert found.to_dict()["plain_flights"] is None


@pytest.mark.slow
def test_a_hit_flies_again_to_the_bit_side_by_side_and_alone(planned, here):
    plan = planned(wanted=GUST, laws=("flagship",), cases=1)
    found = estimate_rare(plan, Threshold("peak_yaw_deg", 0.2), here)
    assert found.probability.low > 0.0
    hit = max(found.hits, key=lambda each: len(each.turns))
    case = make_rare_case(plan, hit.seed, hit.turns, hit.deltas)
    assert fly_many(plan.scenario, plan.laws[0], [case])[0].metrics.peak_yaw_deg == hit.value
    script = case.apply_to(plan.scenario)
    records = fly_direct(script, plan.laws[0], vehicle=case.vehicle, seed=case.seed)
    assert measure(records, case.vehicle, script).peak_yaw_deg == hit.value > 0.2
    assert hit.turns


def test_plain_flights_have_as_wide_a_relative_interval():
    # Counting events of probability p in n flights has a relative error of sqrt((1 - p) / (p n)); 1.96 of them are .5.
    estimate = IntervalEstimate(0.01, 0.01 * math.exp(-0.5), 0.01 * math.exp(0.5))
    found = RareEstimate(law="", event=Threshold("peak_deg", 1.0), probability=estimate, flights=1, levels=(), hits=())
    assert found.plain_flights == pytest.approx(99.0 * 1.96**2 / 0.25)
    assert 1.96 * math.sqrt(0.99 / (0.01 * found.plain_flights)) == pytest.approx(0.5)
