"""Certified gains with delays, sectors and slopes: exact answers, simulations, and evidence that is refused."""

import json
import math
import re
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from math import comb
from typing import Any

import numpy as np
import pytest
from control import ss, tf, tf2ss

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.rotational import Envelope
from gustproof.checker.evidence import CheckResult, seal
from gustproof.checker.evidence import check_certificate as check
from gustproof.checker.quadratic_constraints import LAG, LEAD
from gustproof.design.derive import derive
from gustproof.design.designs import design_problem, load_design
from gustproof.prove.attitude_gain import attitude_loop, certify_gain, command_parts
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.gain.lft_gain import certify_lft, derived_loop
from gustproof.robust.gain.parts import Delay, Part, Sector, Slope
from gustproof.robust.lti.state_space import Lti, as_lti
from gustproof.robust.uncertain.elements import ultidyn, ureal
from gustproof.robust.uncertain.uncertain_system import Uncertain, append, lft

K = 2.0
MARGIN = (math.pi - math.acos(1.0 / K)) / math.sqrt(K**2 - 1.0)
"""[s] delay margin of K / (s + 1)."""


def late() -> Uncertain:
    """Return `x' = -x - K x(t - theta) + w`, z = x."""
    M = Lti(A=[[-1.0 - K]], B=[[-K, 1.0]], C=[[1.0], [1.0]], D=np.zeros((2, 2)))
    return Uncertain(M=M, blocks=ultidyn("late").blocks)


def restless(delta: Uncertain) -> Uncertain:
    """Return `x' = x + delta x + w`, z = x: unstable at Delta = 0."""
    M = Lti(A=[[1.0]], B=[[1.0, 1.0]], C=[[1.0], [1.0]], D=np.zeros((2, 2)))
    return Uncertain(M=M, blocks=delta.blocks)


def lure(num: list[float], den: list[float], slope: float) -> Uncertain:
    """Return the negative feedback of a transfer function and `slope` phi, z = y and w added to its input."""
    G = as_lti(tf2ss(tf(num, den)))
    M = Lti(A=G.A, B=np.hstack([-slope * G.B, G.B]), C=np.vstack([G.C, G.C]), D=np.zeros((2, 2)))
    return Uncertain(M=M, blocks=ultidyn("phi").blocks)


def plant(slope: float) -> Uncertain:
    """Return a loop of third order that the circle holds stable to 1.243, and the criterion of Routh to 4.589."""
    return lure([1.0, -0.2, -0.1], [1.0, 2.0, 1.0, 1.0], slope)


def prove(loop: Uncertain, **parts: Part) -> Certificate:
    return certify_lft(loop, assumes={}, parts=parts)


def test_the_cover_of_a_delay_is_nowhere_too_small():
    """|W|^2 >= 4 sin(x/2)^2 up to pi, >= 4 beyond: polynomials in u = x^2, positive by their Bernstein coefficients."""
    square, beta = 4 * LEAD**2, LAG**2 - 2 * LEAD
    sine = [Fraction(2 * (-1) ** k, math.factorial(2 * k + 2)) for k in range(5)]  # ends above the series
    below = [Fraction(0)] * 7
    for i, a in enumerate(sine):
        for j, b in enumerate((Fraction(1), beta, LEAD**2)):
            below[i + j] += a * b
    difference = [(Fraction(1), square)[k] - below[k] if k < 2 else -below[k] for k in range(7)]
    assert difference[0] == 0
    end, cells = Fraction(79, 8), 8  # above pi^2
    assert float(end) > math.pi**2
    for cell in range(cells):
        low, width = end * cell / cells, end / cells
        moved = [sum(difference[1:][i] * comb(i, k) * low ** (i - k) for i in range(k, 6)) * width**k for k in range(6)]
        assert all(sum(Fraction(comb(i, j), comb(5, j)) * moved[j] for j in range(i + 1)) > 0 for i in range(6))
    # beyond: u (1 + square u) >= 4 (1 + beta u + LEAD^2 u^2)
    assert square == 4 * LEAD**2
    assert (1 - 4 * beta) * end > 4


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_late_lag_is_bounded_almost_up_to_its_delay_margin(share):
    certificate = prove(late(), late=Delay(largest=share * MARGIN))
    assert certificate.proven
    assert check(json.dumps(certificate.to_dict())).accepted
    assert 0.85 * certificate.gain < certificate.lower_bound < certificate.gain


def test_beyond_its_delay_margin_a_late_lag_is_not_proven():
    assert not prove(late(), late=Delay(largest=1.01 * MARGIN)).proven


def test_a_delay_that_varies_at_will_is_bounded_by_the_small_gain():
    """The norm from p to q' is K s / (s + 3), so K: proven up to 1 / K and not beyond."""
    assert prove(late(), late=Delay(largest=0.95 / K, varying=True)).proven
    assert not prove(late(), late=Delay(largest=1.05 / K, varying=True)).proven
    assert prove(late(), late=Delay(largest=1.05 / K)).proven


def test_a_sector_is_proved_up_to_the_circle_and_a_slope_almost_up_to_the_nyquist_value():
    G = plant(1.0).M
    response = G.response(np.geomspace(1e-2, 1e2, 20_001))[:, 0, 1]
    circle = -1.0 / response.real.min()
    nyquist = (0.7 + math.sqrt(0.49 + 0.8)) / 0.4  # (2 + k) (1 - .2 k) = 1 - .1 k
    assert prove(plant(0.99 * circle), phi=Sector()).proven
    assert not prove(plant(1.01 * circle), phi=Sector()).proven
    assert not prove(plant(1.01 * circle), phi=Slope()).proven
    slope = prove(plant(0.95 * nyquist), phi=Slope(poles=(0.3, 1.0, 3.0)))
    assert slope.proven
    assert 0.8 * slope.gain < slope.lower_bound < slope.gain


def test_the_example_of_the_slope_in_the_iqc_toolbox_is_proved():
    """Manual of IQC-beta (Jonsson, Kao, Megretski, Rantzer), iqc_slope_odd, example 2: Popov's criterion fails."""
    den = np.polymul(np.polymul([1.0, 10.0], [1.0, 10.0]), [1.0, 5.0, 20.0])
    G = np.polymul([2.0, 1.0, 2.0], [1.0, 100.0])
    assert not prove(lure(list(G), list(den), 100.0), phi=Sector()).proven
    assert prove(lure(list(G), list(den), 100.0), phi=Slope(poles=(1.0, 10.0, 100.0))).proven


@pytest.mark.slow
def test_parameters_of_any_speed_and_a_delay_are_proved_together():
    pole = ureal("rate", range=(0.8, 1.2))
    loop = append(late(), pole)
    closed = np.array([[1.0, 0.0]]) @ loop @ np.array([[1.0], [0.0]]) @ pole
    certificate = prove(closed, late=Delay(largest=0.3))
    alone = prove(late(), late=Delay(largest=0.3))
    assert certificate.proven
    assert 1.19 * alone.lower_bound < certificate.lower_bound < certificate.gain < 1.21 * alone.gain


def test_no_simulation_of_a_saturated_lag_exceeds_its_bound():
    """x' = -x - 3 sat(x) + w of 4,000 inputs: pulses and harmonics of all sizes."""
    loop = Uncertain(
        M=Lti(A=[[-4.0]], B=[[3.0, 1.0]], C=[[1.0], [1.0]], D=np.zeros((2, 2))), blocks=ultidyn("sat").blocks
    )
    certificate = prove(loop, sat=Slope(poles=(1.0,)))
    assert certificate.proven
    assert certificate.gain == pytest.approx(1.0, rel=5e-3)  # the open loop's: a limit is nothing to a large input
    rng, runs, dt = np.random.default_rng(1), 4000, 0.01
    x, sums = np.zeros(runs), np.zeros((2, runs))
    size, length, omega = 10.0 ** rng.uniform(-2, 3, runs), rng.uniform(0.1, 20.0, runs), rng.uniform(0.0, 3.0, runs)
    for k in range(3000):
        w = size * np.cos(omega * k * dt) * (k * dt < length)
        sums += x**2, w**2
        x = x + dt * (-x - 3.0 * np.clip(x, -1.0, 1.0) + w)
    gains = np.sqrt(sums[0] / sums[1])
    assert 0.8 < gains.max() <= certificate.gain * (1.0 + dt)


def test_a_saturated_integrator_has_no_gain():
    M = Lti(A=[[-1.0]], B=[[1.0, 1.0]], C=[[1.0], [1.0]], D=np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"with slope 1 of 'sat' the loop has a pole at 0.* no global L2 gain exists"):
        prove(Uncertain(M=M, blocks=ultidyn("sat").blocks), sat=Slope())


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: prove(late(), late=Delay(largest=0.1), other=Sector()), "parts name 'other', there are"),
        (lambda: prove(append(late(), ultidyn("new")), late=Delay(largest=0.1)), "'new' is no real parameter"),
        (lambda: prove(ultidyn("wide", 2, 1), wide=Sector()), "is 2 x 1, a part must be square"),
        (lambda: certify_lft(late(), assumes={}, speeds={}, parts={"late": Sector()}), "not proved together"),
        (lambda: Delay(largest=0.0), "must be positive"),
        (lambda: Delay(largest=1.0, poles=(-1.0,)), "must be positive"),
        (lambda: Delay(largest=1.0, varying=True, poles=(1.0,)), "has no poles"),
        (lambda: Slope(poles=(math.inf,)), "must be positive"),
        (lambda: prove(restless(ultidyn("late")), late=Delay(largest=0.1)), "continuous and stable at Delta = 0"),
        (lambda: certify_lft(restless(ureal("pole", range=(-1.0, 1.0))), assumes={}), "stable at Delta = 0"),
        (
            lambda: certify_lft(restless(ureal("a b", range=(-1.0, 1.0))), assumes={}),
            "block 'a b': .* by ASCII letters",
        ),
        (lambda: command_parts(None, 1.0), r"saturation is 1\.0, must be above 1"),
    ],
)
def test_what_is_no_loop_of_parts_is_named(make, reason):
    with pytest.raises(ValueError, match=reason):
        make()


@cache
def text_of(kind: str) -> str:
    made = {
        "delay": lambda: prove(late(), late=Delay(largest=0.5, poles=(1.0,))),
        "varying": lambda: prove(late(), late=Delay(largest=0.2, varying=True)),
        "sector": lambda: prove(plant(1.0), phi=Sector()),
        "slope": lambda: prove(plant(3.0), phi=Slope(poles=(1.0,))),
    }
    return json.dumps(made[kind]().evidence)


def forge(kind: str, *path: str | int, to: Any) -> CheckResult:
    """Return the verdict on evidence in which the value at `path` is another, sealed anew."""
    evidence: Any = json.loads(text_of(kind))
    place = evidence
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = to(place.get(path[-1]) if isinstance(place, dict) else place[path[-1]]) if callable(to) else to
    document = {"format": "gustproof-certificate-1", "evidence": evidence}
    return check(json.dumps({**document, "seal": seal(document)}))


BLOCK = ("blocks", 0)


@pytest.mark.parametrize("kind", ["delay", "varying", "sector", "slope"])
def test_evidence_is_accepted_and_says_of_what(kind):
    verdict = forge(kind, "kind", to="constrained gain")
    assert verdict.accepted
    said = {
        "delay": "'late': every constant delay of all its channels in [0, 0.5] s",
        "varying": "'late': every delay of all its channels that varies at will in [0, 0.2] s",
        "sector": "'phi': functions phi(q, t) of each channel between 0 and q",
        "slope": "'phi': odd functions phi(q) of each channel with slopes in [0, 1]",
    }
    assert verdict.assumes["parts"] == [said[kind]]
    assert said[kind] in verdict.reason


FORGERIES: dict[str, tuple[Callable[[], CheckResult], str]] = {
    "longer delay": (lambda: forge("delay", *BLOCK, "largest", to=0.6), "does not hold|not proved stable"),
    "longer varying delay": (lambda: forge("varying", *BLOCK, "largest", to=0.21), "does not hold"),
    "no delay": (lambda: forge("delay", *BLOCK, "largest", to=0.0), "delay of block late is not positive"),
    "delay in words": (lambda: forge("delay", *BLOCK, "largest", to="0.5"), "must be a finite number"),
    "lower level": (lambda: forge("delay", "level", to=lambda level: 0.995 * level), "does not hold"),
    "X negative": (lambda: forge("delay", *BLOCK, "X", to=[[-1.0, 0.0], [0.0, -1.0]]), "X .* is not positive definite"),
    "Y negative": (lambda: forge("delay", *BLOCK, "Y", to=[[-1.0, 0.0], [0.0, -1.0]]), "Y .* is not positive definite"),
    "X small": (lambda: forge("delay", *BLOCK, "X", to=[[1.0]]), "X of block late does not have its size"),
    "varying called constant": (lambda: forge("varying", *BLOCK, "kind", to="delay"), "other entries"),
    "constant called varying": (lambda: forge("delay", *BLOCK, "kind", to="varying delay"), "other entries"),
    "slope called a sector": (lambda: forge("slope", *BLOCK, "kind", to="sector"), "other entries"),
    "unknown kind": (lambda: forge("slope", *BLOCK, "kind", to="oath"), "unknown kind 'oath'"),
    "kind in a list": (lambda: forge("slope", *BLOCK, "kind", to=["slope"]), "unknown kind"),
    "a speed beside": (lambda: forge("slope", *BLOCK, "speed", to=1.0), "other entries"),
    "parts called parameters": (lambda: forge("slope", "kind", to="gain"), "other entries"),
    "unstable pole": (lambda: forge("slope", *BLOCK, "poles", to=[-1.0]), "pole of block phi is not positive"),
    "another pole": (lambda: forge("slope", *BLOCK, "poles", to=[0.01]), "does not hold|not proved stable"),
    "T negative": (lambda: forge("sector", *BLOCK, "T", to=[-1.0]), "T of block phi is not positive"),
    "T of two channels": (lambda: forge("sector", *BLOCK, "T", to=[1.0, 1.0]), "T of block phi does not have its size"),
    "multiplier too large": (
        lambda: forge("slope", *BLOCK, "causal", to=lambda rows: [[2.0 * abs(rows[0][0]) + 1e3]]),
        "larger than the slope allows",
    ),
    "multiplier of no pole": (lambda: forge("slope", *BLOCK, "anticausal", to=[]), "does not have its size"),
    "odd by a number": (lambda: forge("slope", *BLOCK, "odd", to=1), "neither odd nor not"),
    "negative for a function that is not odd": (
        lambda: forge("slope", *BLOCK, "odd", to=False),
        "is negative, which only an odd function allows",
    ),
    "unstable system": (lambda: forge("slope", "system", "A", 0, 0, to=5.0), "not proved stable"),
    "stability negative": (lambda: forge("delay", "stability", 0, 0, to=-1.0), "stability is not positive definite"),
    "a part that sees itself": (lambda: forge("slope", "system", "D", 0, 0, to=0.5), "sees at once what a later part"),
    "an input that jumps": (lambda: forge("varying", "system", "D", 0, 1, to=1e-9), "may jump"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forgery_is_refused(name):
    make, reason = FORGERIES[name]
    verdict = make()
    if name.startswith("negative for"):
        signs = [value < 0 for row in json.loads(text_of("slope"))["blocks"][0]["causal"] for value in row]
        assert any(signs), "the example has a negative multiplier"
    assert not verdict.accepted
    assert re.search(reason, verdict.reason)


def test_a_derived_loop_is_covered_by_a_longer_delay_and_by_no_other_part():
    text = json.dumps(prove(late(), late=Delay(largest=0.5)).to_dict())

    def judge(part: Part) -> CheckResult:
        return check(text, loop=derived_loop(late(), None, {"late": part}))

    assert judge(Delay(largest=0.5)).accepted
    assert judge(Delay(largest=0.4)).accepted
    for part in (Delay(largest=0.51), Delay(largest=0.4, varying=True), Sector(), Slope()):
        assert judge(part).reason == "late of the derived loop is more than the evidence allows"


def test_of_functions_that_are_not_odd_less_is_proved():
    odd, any_ = (prove(plant(3.0), phi=Slope(odd=odd, poles=(1.0,))) for odd in (True, False))
    assert odd.proven
    assert any_.gain is None or any_.gain > 1.002 * odd.gain
    document = json.dumps(odd.to_dict())
    loop = derived_loop(plant(3.0), None, {"phi": Slope(odd=False)})
    assert "more than the evidence allows" in check(document, loop=loop).reason


@pytest.mark.slow
def test_the_papers_law_keeps_a_gain_with_commands_half_above_their_limit():
    design = load_design("D2")
    problem, controller = design_problem(design, load_vehicle("paper")), derive(design)[1].result.lti
    certificate = certify_gain(problem, controller, angle=0.1, rate=0.5, saturation=1.5)
    assert certificate.assumes["plant"].endswith("commands of at most 1.5 times the limit")
    assert certificate.gain < 4.27
    assert 2.4 < certificate.lower_bound < certificate.gain
    loop = attitude_loop(problem, controller, Envelope(angle=0.1, rate=0.5), scheduled=False, saturation=1.5)
    parts = {"saturation": Sector()}
    assert check(json.dumps(certificate.to_dict()), loop=derived_loop(loop, None, parts)).accepted


def test_a_loop_without_channels_has_no_gain():
    plant = ss(-1.0, 2.0, 1.0, 0.0) @ ultidyn("late")
    with pytest.raises(ValueError, match="no inputs or no outputs left"):
        certify_lft(lft(plant, ss([], [], [], -1.0)), assumes={}, parts={"late": Delay(largest=0.5)})
