"""`gustproof design`: each method's law, what is printed of it, and options that a method does not take."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.design import fixed_order, methods
from gustproof.design.derive import derive
from gustproof.design.designs import load_design
from gustproof.errors import DesignError
from gustproof.law.form import load_law
from gustproof.prove import attitude_gain
from gustproof.prove.boundedness import certify_boundedness
from gustproof.robust.gain import lft_gain
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.hinf.checked_controller import CheckedController
from gustproof.robust.lpv.lpvsyn import LftController
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.uncertain.uncertain_system import Uncertain


def run(*arguments: str):
    return CliRunner().invoke(app, ["design", *arguments])


def told(*arguments: str) -> dict[str, Any]:
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    figures: dict[str, Any] = json.loads(result.stdout)
    return figures


@pytest.mark.slow
def test_a_shaped_law_crosses_where_asked_with_the_margin_told_and_its_flight_is_proven(tmp_path: Path):
    path = tmp_path / "shaped.json"
    figures = told("ncfsyn", "D2", "--crossover", "15", "-o", str(path))
    assert (figures["method"], figures["law"], figures["gamma_opt"]) == ("ncfsyn", "D2-ncfsyn", None)
    assert figures["norm"] <= figures["gamma"]
    assert sum("a margin of" in check for check in figures["checks"]) == 3
    for axis in ("roll", "pitch", "yaw"):
        flown = figures["sampled"]["input"][axis]
        assert 0.5 * 15.0 < flown["crossover_rad_s"] < 1.5 * 15.0
        assert flown["phase_margin_deg"] > 45.0
    law = load_law(path)
    assert (law.name, law.order, law.is_scheduled) == ("D2-ncfsyn", figures["order"], False)
    assert certify_boundedness(path, "paper", moment=(0.1, 0.1, 0.05), horizon=None).proven


def test_the_law_of_least_rms_has_its_checks_and_no_frequency():
    result = run("h2syn", "D2")
    assert result.exit_code == 0
    assert "checked" in result.stdout
    figures = told("h2syn", "D2")
    assert figures["norm_omega_rad_s"] is None
    central = derive(load_design("D2"))[1]
    assert figures["sampled"]["input"]["roll"]["Ms"] != pytest.approx(central.sampled.input[0].Ms, rel=1e-3)


def test_musyn_designs_over_the_envelope_and_tells_what_was_proved(monkeypatch: pytest.MonkeyPatch):
    asked: dict[str, Any] = {}
    central = derive(load_design("D2"))[1].result

    def musyn(plant: Any, n_meas: int, n_con: int, **options: Any) -> CheckedController:
        asked.update(options, blocks=[block.name for block in plant.blocks], sizes=(n_meas, n_con))
        return CheckedController(lti=central.lti, gamma=3.0, norm=2.0, omega=1.0, checks=("stable",))

    monkeypatch.setattr(methods, "musyn", musyn)
    monkeypatch.setattr(methods, "certify_gain", lambda *_, **__: CERTIFICATE)
    figures = told("musyn", "D2", "--angle-rad", "0.3", "--rate-rad-s", "0.5")
    assert (asked["measure"], asked["sizes"]) == ("l2gain", (3, 3))
    assert sorted(asked["blocks"]) == ["q", "r", "t", "v"]
    assert figures["checks"] == ["stable", "proven exactly: the gain is below 3"]
    assert (figures["law"], figures["gamma"]) == ("D2-musyn", 3.0)


@pytest.fixture
def scheduled(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Let `lpv` find the central controller with two small terms in q at once; return what it is asked."""
    asked: dict[str, Any] = {}

    def lpvsyn(plant: Any, n_meas: int, n_con: int, **options: Any) -> LftController:
        K = derive(load_design("D2"))[1].result.lti
        block = next(block for block in plant.blocks if block.name == "q")
        M = Lti(
            A=K.A,
            B=np.hstack([1e-3 * np.eye(9, 1), K.B]),
            C=np.vstack([np.eye(1, 9, 3), K.C]),
            D=np.pad(K.D, ((1, 0), (1, 0))),
        )
        asked.update(options, blocks=[block.name for block in plant.blocks], sizes=(n_meas, n_con))
        lft = Uncertain(M=M, blocks=(replace(block, repeats=1),))
        return LftController(
            lti=lft.nominal_system(), gamma=0.4, norm=0.3, omega=1.0, checks=(), gamma_opt=0.2, scheduled=lft
        )

    monkeypatch.setattr(methods, "lpvsyn", lpvsyn)
    return asked


CERTIFICATE = Certificate(
    statement="the gain is below 3", gain=3.0, lower_bound=2.0, proven=True, assumes={}, evidence={}, residual=0.0
)


@pytest.mark.slow
def test_lpv_designs_a_law_with_a_schedule_and_certify_takes_its_loop_out_of_the_file(
    scheduled: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    loops: list[Uncertain] = []

    def certify_lft(loop: Uncertain, **_: Any) -> Certificate:
        loops.append(loop)
        return CERTIFICATE

    monkeypatch.setattr(methods, "certify_lft", certify_lft)
    monkeypatch.setattr(attitude_gain, "certify_lft", certify_lft)
    path, envelope = tmp_path / "turned.json", ("--angle-rad", "0.01", "--rate-rad-s", "0.05")
    figures = told("lpv", "D2", *envelope, "--backoff", "1.1", "-o", str(path))
    assert (scheduled["backoff"], scheduled["sizes"]) == (1.1, (3, 3))
    assert sorted(scheduled["blocks"]) == ["q", "r", "t", "v"]
    assert figures["checks"] == ["proven exactly: the gain is below 3"]
    assert (figures["law"], figures["scheduled"], figures["gamma_opt"]) == ("D2-lpv", True, 0.2)
    law = load_law(path)
    assert law.schedule is not None
    assert (law.schedule.parameters, law.schedule.limits.tolist()) == (("q",), [0.05])
    assert law.rate_limit is not None
    certified = CliRunner().invoke(app, ["certify", "gain", str(path), "--angle-rad", "0.005", "--rate-rad-s", "0.025"])
    assert certified.exit_code == 0, certified.output
    designed, read = loops
    for delta in ({block.name: share for block in designed.blocks} for share in (-0.4, 0.7)):
        rates = {name: 0.5 * value for name, value in delta.items() if name in "qr"}  # within the envelope of both
        own = designed.member(rates)
        other = read.member({name: 2.0 * value for name, value in rates.items()})
        np.testing.assert_allclose(other.response([0.5, 20.0]), own.response([0.5, 20.0]), rtol=1e-6, atol=1e-9)
    for options, words in (
        (("gain", "--angle-rad", "0.01", "--rate-rad-s", "0.1"), "scheduled on 'q' up to 0.05, the envelope is 0.1"),
        (("box",), "is scheduled on attitude and rates, the proof is about laws without schedule"),
    ):
        refused = CliRunner().invoke(app, ["certify", options[0], str(path), *options[1:]])
        assert refused.exit_code == 2, refused.output
        assert words in refused.output


@pytest.mark.slow
def test_the_gain_of_a_law_file_is_checked_of_that_file_and_of_no_other(
    scheduled: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr(methods, "certify_lft", lambda *_, **__: CERTIFICATE)
    monkeypatch.setattr(lft_gain, "lower_bound", lambda *_: 0.2)
    path, envelope = tmp_path / "turned.json", ("--angle-rad", "0.01", "--rate-rad-s", "0.05")
    told("lpv", "D2", *envelope, "-o", str(path))
    law, other, proof = load_law(path), tmp_path / "other.json", tmp_path / "proof.json"
    replace(law, B=(1.0 + 1e-4) * law.B).save(other)

    def verdict(*words: str) -> tuple[int, dict[str, Any]]:
        done = CliRunner().invoke(app, ["certify", *words, *envelope, "--json"])
        return done.exit_code, json.loads(done.stdout)

    status, certified = verdict("gain", str(path), "-o", str(proof))
    assert (status, certified["proven"]) == (0, True)
    status, checked = verdict("check", str(proof), "--design", str(path))
    assert (status, checked["gain"], checked["lower_bound"]) == (0, certified["gain"], 0.2)
    assert "derived from the law's file and its design" in checked["assumes"]["plant"]
    status, refused = verdict("check", str(proof), "--design", str(other))
    assert (status, refused["reason"]) == (1, "the matrix inequality does not hold")


def test_a_gain_is_of_a_law_file_with_a_schedule_from_a_shipped_design(make_law: Any, turn: Any, tmp_path: Path):
    for law, words in (
        (load_law("hinf-d2"), "has no schedule; give the design"),
        (turn(load_law("hinf-d2")), "no shipped design"),
    ):
        named = replace(law, provenance=replace(law.provenance, design="mine: own weights"))
        named.save(tmp_path / "law.json")
        arguments = ["certify", "gain", str(tmp_path / "law.json"), "--angle-rad", "0.1", "--rate-rad-s", "0.1"]
        refused = CliRunner().invoke(app, arguments)
        assert refused.exit_code == 2
        assert words in refused.output


def test_hinfstruct_is_asked_for_the_decay_and_the_size(monkeypatch: pytest.MonkeyPatch):
    asked: list[Any] = []

    def hinfstruct(*_: Any, hard_goals: Any, **__: Any) -> Any:
        asked.extend(hard_goals)
        raise DesignError("no more is asked")

    monkeypatch.setattr(fixed_order, "hinfstruct", hinfstruct)
    refused = run("hinfstruct", "D1", "3", "--keep", "decay=0.02, max-gain=9")
    assert (refused.exit_code, refused.output) == (2, "gustproof: no more is asked\n")
    decay, size = asked
    assert (decay.minimum, size.limit, size.entries) == (0.02, 9.0, False)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("lpv", "D2"), "Missing option '--angle-rad'"),
        (("lpv", "R1", "--angle-rad", "0.1", "--rate-rad-s", "1"), "torque designs only"),
        (("hinfstruct", "D2", "3", "--keep", "decay=0"), "--keep: decay is '0', must be a positive number"),
        (("hinfstruct", "D2", "3", "--keep", "max-gain=inf"), "--keep: max-gain is 'inf', must be"),
        (("hinfstruct", "D2", "3", "--keep", "decay=1, decay=2"), "'decay=2' is not one decay=D or max-gain=K"),
        (("hinfstruct", "D2", "3", "--keep", "gain"), "'gain' is not one"),
        (("hinfsyn", "D2", "--keep", "decay=1"), "No such option"),
        (("h2syn", "D2", "--gamma", "1"), "No such option"),
        (("musyn", "D2", "--angle-rad", "0.1"), "Missing option '--rate-rad-s'"),
        (("hinfstruct", "D2", "3", "--angle-rad", "0.1"), "--angle-rad and --rate-rad-s go together"),
        (("D2", "--gamma", "1"), "'D2' is none of hinfsyn, h2syn, hinfstruct, ncfsyn, musyn, lpv, list, show"),
        (("musyn", "D2", "--angle-rad", "2", "--rate-rad-s", "1"), "below pi/2"),
        (("hinfstruct", "D2"), "Missing argument 'order'"),
        (("ncfsyn", "D2", "--crossover", "0"), "--crossover: is 0.0, must be positive"),
        (("ncfsyn", "R1"), "shapes the loop from torque to gyro"),
        (("musyn", "R1", "--angle-rad", "0.1", "--rate-rad-s", "1"), "torque designs only"),
        (("ncfsyn", "D2", "--crossover", "300"), "one sample late"),
        (("systune", "D2"), "systune"),
    ],
)
def test_an_option_that_a_method_does_not_take_is_refused(arguments, words):
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in result.output
