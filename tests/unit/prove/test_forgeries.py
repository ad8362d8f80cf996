"""Thought-out forgeries, each sealed again: evidence of other flights, other files, easier classes, broken numbers."""

import json
import re
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from firmware_model.config.vehicle import vehicle_path
from gustproof.checker.evidence import check_certificate as check
from gustproof.checker.evidence import seal
from gustproof.checker.flight_box import InterSampleMoment
from gustproof.checker.system import sha256
from gustproof.law.form import law_path
from gustproof.prove.boundedness import certify_boundedness
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.gain.lft_gain import certify_lft
from gustproof.robust.uncertain.elements import ureal
from gustproof.robust.uncertain.uncertain_system import Uncertain, system_from_matrix

MOMENT = (0.65, 0.65, 0.3)
VEHICLE = vehicle_path("paper").read_text(encoding="utf-8")
Evidence = dict[str, Any]


def law_text(name: str = "flagship") -> str:
    return law_path(name).read_text(encoding="utf-8")


@lru_cache
def _flight(name: str, options: tuple[tuple[str, Any], ...]) -> str:
    made = certify_boundedness(name, "paper", moment=MOMENT, horizon=60.0, **dict(options))
    assert made.proven
    return json.dumps(made.evidence)


def flight(name: str = "flagship", **options: Any) -> Evidence:
    return json.loads(_flight(name, tuple(options.items())))


def lag(spread: float) -> Uncertain:
    """Return `x' = -(1 + spread delta) x + w`, z = x."""
    rate = ureal("rate", range=(1.0 - spread, 1.0 + spread))
    pole = np.array([[1.0], [0.0]]) @ rate @ np.array([[-1.0, 0.0]])
    return system_from_matrix(pole + np.array([[0.0, 1.0], [1.0, 0.0]]), 1)


@lru_cache
def _gain(spread: float, speed: float | None) -> Certificate:
    return certify_lft(lag(spread), assumes={}, speeds=None if speed is None else {"rate": speed})


def gain(spread: float = 0.5, speed: float | None = None) -> Evidence:
    made = _gain(spread, speed)
    assert made.proven
    return json.loads(json.dumps(made.evidence))


def sealed(evidence: Any) -> str:
    document = {"format": "gustproof-certificate-1", "evidence": evidence}
    return json.dumps({**document, "seal": seal(document)})


def doubled(evidence: Evidence, key: str, first: str) -> str:
    """Return a sealed certificate with `key` twice: a reader sees `first`, a parser takes the last."""
    text = sealed(evidence)
    assert text.count(f'"{key}": ') == 1
    return text.replace(f'"{key}": ', f'"{key}": {first}, "{key}": ')


def law_with(change: Callable[[Evidence], Any]) -> str:
    law = json.loads(law_text())
    change(law)
    return json.dumps(law)


def vehicle_with(old: str, new: str) -> str:
    assert old in VEHICLE
    return VEHICLE.replace(old, new, 1)


@pytest.mark.slow
def test_what_is_forged_below_is_accepted_as_it_was():
    for name in ("flagship", "hinf-scheduled", "pid-fair"):
        assert check(sealed(flight(name)), law=law_text(name), vehicle=VEHICLE).accepted
    for evidence in (gain(), gain(0.3), gain(0.5, 1.0)):
        assert check(sealed(evidence)).accepted


OTHER_LAWS = {
    "law of this name, half as strong": (lambda law: law.update(C=(0.5 * np.array(law["C"])).tolist()), "not close"),
    "law of this name, twice as strong": (lambda law: law.update(D=(2.0 * np.array(law["D"])).tolist()), "not close"),
    "sampled half as often": (lambda law: law.update(dt=0.008), "too slow"),
    "sampled twice as often": (lambda law: law.update(dt=0.002), "too slow"),
    "command limits of a feather": (lambda law: law.update(limits=[1.0] * 3), "may reach its limit"),
    "rates for torques": (lambda law: law.update(output="rates"), "bound every signal"),
    "rate limit that acts": (lambda law: law["rate_limit"].update(limits=[0.1] * 3), "limit of the rate"),
    "statement in the law's name": (
        lambda law: law.update(name="f' keeps its own attitude within .1 deg for ever. Law 'f"),
        "holds no quote",
    ),
    "lines in the law's name": (lambda law: law.update(name="f\nproven: within .1 deg"), "holds no quote"),
    "law of no name": (lambda law: law.update(name=["flagship"]), "malformed"),
    "coupled axes": (lambda law: law["A"][0].__setitem__(1, 1e-9), "couples its axes"),
    "a number that is none": (lambda law: law["A"][0].__setitem__(0, float("nan")), "not finite"),
}


@pytest.mark.parametrize("name", OTHER_LAWS)
def test_a_box_is_no_proof_of_another_law_bound_to_it(name):
    change, reason = OTHER_LAWS[name]
    text = law_with(change)
    evidence = {**flight(), "law_sha256": sha256(text), "samples": 4096}  # enough for slower loops too
    verdict = check(sealed(evidence), law=text, vehicle=VEHICLE)
    assert not verdict.accepted
    assert reason in verdict.reason


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("nominal = 0.25, low = 0.2", "nominal = 0.2, low = 0.15", "does not close"),
        ("nominal = 0.05", "nominal = 0.06", "does not close"),
        ("range = 34.9", "range = 0.01", "gyro's range"),
        ("torque_limit = [10.0, 10.0, 10.0]", "torque_limit = [2.0, 10.0, 10.0]", "may reach its limit"),
        ("rate_damping = 0.02", "rate_damping = -0.02", "must not be negative"),
    ],
)
def test_a_box_is_no_proof_of_another_vehicle_bound_to_it(old, new, reason):
    text = vehicle_with(old, new)
    verdict = check(sealed({**flight(), "vehicle_sha256": sha256(text)}), law=law_text(), vehicle=text)
    assert not verdict.accepted
    assert reason in verdict.reason


def box_with(value: float) -> list[list[float]]:
    box = flight()["box"]
    box[1][5] = value
    return box


FLIGHTS: dict[str, tuple[Callable[[], str], str]] = {
    "box of the scheduled law": (lambda: sealed({**flight(), "box": flight("hinf-scheduled")["box"]}), "every signal"),
    "hash of the fair PID": (lambda: sealed({**flight(), "law_sha256": sha256(law_text("pid-fair"))}), "the law file"),
    "hash in capitals": (lambda: sealed({**flight(), "law_sha256": sha256(law_text()).upper()}), "the law file"),
    "moment about the wrong axis": (lambda: sealed({**flight(), "moment": [0.3, 0.65, 0.65]}), "does not close"),
    "moment one bit larger": (
        lambda: sealed({**flight(), "moment": [float(np.nextafter(value, 9.0) * 1.001) for value in MOMENT]}),
        "does not close",
    ),
    "part of a part": (lambda: sealed({**flight(), "moment": [1.3, 1.3, 0.6], "part": 0.51}), "does not close"),
    "noise in a calm box": (lambda: sealed({**flight(), "noise": 0.0036, "risk": 1e-3}), "does not close"),
    "twice the noise": (lambda: sealed({**flight(noise=0.0036), "noise": 0.0072}), "does not close"),
    "less risk": (lambda: sealed({**flight(noise=0.0036), "risk": 1e-9}), "does not close"),
    "a longer horizon in noise": (lambda: sealed({**flight(noise=0.0036), "horizon": 60000.0}), "does not close"),
    "no noise at a risk": (lambda: sealed({**flight(noise=0.0036), "noise": 0.0}), "0 without noise"),
    "denormal risk": (lambda: sealed({**flight(noise=0.0036), "risk": 5e-324}), "risk is 5e-324"),
    "spreads in a nominal box": (
        lambda: sealed({**flight(), "inertia_spread": 0.2, "lag_spread": 0.3, "cells": [2, 3]}),
        "does not close",
    ),
    "spread below nothing": (lambda: sealed({**flight(), "lag_spread": -1e-9}), "a spread is a share"),
    "slope without its class": (lambda: sealed({**flight(), "moment_class": "any", "slope": [9.0] * 3}), "a slope"),
    "class in capitals": (lambda: sealed({**flight(), "moment_class": "HELD"}), "malformed"),
    "bound that is not a number": (lambda: sealed({**flight(), "box": box_with(float("nan"))}), "NaN is no number"),
    "infinite bound": (lambda: sealed({**flight(), "box": box_with(float("inf"))}), "Infinity is no number"),
    "bound of a huge exponent": (
        lambda: sealed({**flight(), "box": box_with(7e77)}).replace("7e+77", "1e999"),
        "does not fit",
    ),
    "large finite bound": (lambda: sealed({**flight(), "box": box_with(1e308)}), "does not close"),
    "denormal bound": (lambda: sealed({**flight(), "box": box_with(5e-324)}), "does not close"),
    "bound of minus nothing": (lambda: sealed({**flight(), "box": box_with(-0.0)}), "does not close"),
    "a fourth axis": (lambda: sealed({**flight(), "box": [*flight()["box"], flight()["box"][0]]}), "every signal"),
    "a signal less": (lambda: sealed({**flight(), "box": [row[1:] for row in flight()["box"]]}), "every signal"),
    "a signal more": (lambda: sealed({**flight(), "box": [[*row, 1.0] for row in flight()["box"]]}), "every signal"),
    "box by name": (lambda: sealed({**flight(), "box": {"x": 1.0, "y": 1.0, "z": 1.0}}), "must be 1 numbers"),
    "samples in words": (lambda: sealed({**flight(), "samples": "512"}), "whole numbers"),
    "horizon in words": (lambda: sealed({**flight(), "horizon": "inf"}), "finite number"),
    "part twice": (lambda: doubled(flight(), "part", "1e-3"), "a key stands twice"),
    "moment twice": (lambda: doubled(flight(), "moment", "[9, 9, 9]"), "a key stands twice"),
    "evidence twice": (lambda: doubled(flight(), "evidence", "{}"), "a key stands twice"),
    "an integer of many digits": (lambda: sealed({**flight(), "part": 7}).replace("7,", "7" * 5000 + ","), "malformed"),
    "a large integer": (lambda: sealed({**flight(), "noise": 10**400, "risk": 0.1}), "malformed"),
    "called a gain": (lambda: sealed({**flight(), "kind": "gain"}), "bound to no such file"),
    "two certificates": (lambda: f"[{sealed(flight())}, {sealed(flight())}]", "format is not"),
    "words behind it": (lambda: sealed(flight()) + " proven", "malformed"),
    "no seal": (lambda: json.dumps({"format": "gustproof-certificate-1", "evidence": flight()}), "does not fit"),
    "seal of other evidence": (
        lambda: sealed(flight()).replace('"part": 1.0', '"part": 0.5'),
        "does not fit",
    ),
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_thought_out_forgery_of_a_flight_is_refused(name):
    make, reason = FLIGHTS[name]
    verdict = check(make(), law=law_text(), vehicle=VEHICLE)
    assert not verdict.accepted
    assert reason in verdict.reason


def with_block(evidence: Evidence, **changes: Any) -> str:
    evidence["blocks"][0].update(changes)
    return sealed(evidence)


def with_system(evidence: Evidence, **changes: Any) -> str:
    evidence["system"].update(changes)
    return sealed(evidence)


GAINS: dict[str, tuple[Callable[[], str], str]] = {
    "P of an easier loop": (lambda: sealed({**gain(), "P": gain(0.3)["P"]}), "does not hold"),
    "all of an easier loop but the system": (lambda: sealed({**gain(0.3), "system": gain()["system"]}), "not hold"),
    "level a thousandth lower": (lambda: sealed({**gain(), "level": 0.999 * gain()["level"]}), "does not hold"),
    "denormal level": (lambda: sealed({**gain(), "level": 5e-324}), "does not hold"),
    "level true": (lambda: sealed({**gain(), "level": True}), "must be a finite number"),
    "huge level of an unstable loop": (lambda: with_system({**gain(), "level": 1e300}, A=[[0.1]]), "does not hold"),
    "no coordinates": (lambda: sealed({**gain(), "coordinates": [[0.0]]}), "P is not positive definite"),
    "P of wrong shape": (lambda: sealed({**gain(), "P": [[1.0, 0.0], [0.0, 1.0]]}), "malformed"),
    "columns moved from A to B": (
        lambda: with_system(gain(), A=[[]], B=[[*gain()["system"]["A"][0], *gain()["system"]["B"][0]]]),
        "wrong shapes",
    ),
    "an output less": (lambda: with_system(gain(), C=gain()["system"]["C"][:1]), "wrong shapes"),
    "an input less": (lambda: with_system(gain(), B=[row[:1] for row in gain()["system"]["B"]]), "wrong shapes"),
    "a block larger than the system": (lambda: with_block(gain(), size=3), "more than the system"),
    "an uncertainty of no size": (lambda: with_block(gain(), size=0, D=[], G=[]), "positive whole number"),
    "size true": (lambda: with_block(gain(), size=True), "positive whole number"),
    "size 1.0": (lambda: with_block(gain(), size=1.0), "positive whole number"),
    "statement in a block's name": (
        lambda: with_block(gain(), name="rate: the matrix inequality holds for gain .1, and"),
        "must have a name of ASCII letters",
    ),
    "a block of no name": (lambda: with_block(gain(), name=["rate"]), "must have a name of ASCII letters"),
    "no block": (lambda: sealed({**gain(), "blocks": []}), "names no block"),
    "speed in words": (lambda: with_block(gain(0.5, 1.0), speed="0.5"), "finite number"),
    "no speed": (lambda: with_block(gain(0.5, 1.0), speed=None), "malformed"),
    "a speed below nothing": (lambda: with_block(gain(0.5, 1.0), speed=-5e-324), "speed is negative"),
    "a slow block with other entries": (
        lambda: with_block(gain(0.5, 1.0), note=1),
        "slow parameters has other entries",
    ),
    "a corner less": (lambda: sealed({**gain(0.5, 1.0), "vertices": gain(0.5, 1.0)["vertices"][:-1]}), "malformed"),
    "a gain called slow": (lambda: sealed({**gain(), "kind": "slow gain"}), "other entries"),
    "a gain called a flight": (lambda: sealed({**gain(), "kind": "boundedness"}), "give both"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", GAINS)
def test_a_thought_out_forgery_of_a_gain_is_refused(name):
    make, reason = GAINS[name]
    verdict = check(make())
    assert not verdict.accepted
    assert re.search(reason, verdict.reason)


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({"horizon": 600.0}, {"horizon": 600.0}),
        ({"horizon": None}, {"horizon": None}),
        ({"moment_class": "any"}, {"moment_class": InterSampleMoment.ANY}),
        (
            {"moment_class": "slope", "slope": [99.0, 99.0, 99.0]},
            {"moment_class": InterSampleMoment.SLOPE, "slope": (99.0, 99.0, 99.0)},
        ),
    ],
)
def test_a_harder_claim_of_the_same_evidence_is_made_with_its_own_figures(changes, options):
    """Horizon and class of moment do not enter the box: the claim is then the true, weaker one, and never the old."""
    verdict = check(sealed({**flight(), **changes}), law=law_text(), vehicle=VEHICLE)
    honest = certify_boundedness("flagship", "paper", **{"moment": MOMENT, "horizon": 60.0, **options})
    assert verdict.accepted
    assert (verdict.reason, verdict.figures["truth_deg"]) == (honest.statement, honest.truth_deg)
    old = check(sealed(flight()), law=law_text(), vehicle=VEHICLE).figures["truth_deg"]
    assert verdict.figures["truth_deg"] is None or min(verdict.figures["truth_deg"]) > max(old)


def test_no_bit_of_a_law_file_may_be_another():
    """Each of 400 bits over the whole file, one at a time."""
    data, certificate = law_text().encode(), sealed(flight())
    rng = np.random.default_rng(4)
    for at, bit in zip(rng.integers(len(data), size=400).tolist(), rng.integers(7, size=400).tolist(), strict=True):
        changed = bytearray(data)
        changed[at] ^= 1 << bit
        verdict = check(certificate, law=changed.decode(), vehicle=VEHICLE)
        assert not verdict.accepted
        assert "the law file is not the one" in verdict.reason
