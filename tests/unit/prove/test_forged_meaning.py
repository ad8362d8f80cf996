"""Forgeries of meaning, each sealed again: sound numbers that would say something else than what is proved."""

import json
import math
import re
import time
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import lru_cache, partial
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import pytest

from firmware_model.config.vehicle import Vehicle, vehicle_path
from gustproof.checker.directed_rounding import list_down, list_up, percent_down, print_down, print_up
from gustproof.checker.evidence import CheckResult, DerivedLoop, check_certificate, seal
from gustproof.checker.system import LAW_KEYS, VEHICLE_FIELDS, Use, list_uncovered, sha256
from gustproof.law.form import law_path, load_law
from gustproof.prove.boundedness import certify_boundedness

LAW = law_path("flagship").read_text(encoding="utf-8")
VEHICLE = vehicle_path("paper").read_text(encoding="utf-8")
SCENARIO = 'description = "air"\nduration_s = 1.0\n'
Evidence = dict[str, Any]
SYSTEM = {
    "A": [[-1.0]],
    "B": [[0.25, 1.0]],
    "C": [[1.0], [1.0]],
    "D": [[0.0, 0.0], [0.0, 0.0]],
}
"""x' = -(1 - delta / 4) x + w, z = x: a gain of 4/3."""


def gain(**changes: Any) -> Evidence:
    block = {"name": "rate", "size": 1, "D": [[0.4]], "G": [[0.0]]}
    made = {"kind": "gain", "level": 2.0, "system": SYSTEM, "coordinates": [[1.0]], "P": [[1.5]], "blocks": [block]}
    return json.loads(json.dumps({**made, **changes}))


def slow(**changes: Any) -> Evidence:
    """Return evidence of the same gain with a speed of 0 and P the same at all corners."""
    made = gain(kind="slow gain", P=[[[1.5]], [[0.0]]], Y=[[0.0, 0.0, 0.0]])
    made["blocks"] = [{"name": "rate", "size": 1, "speed": 0.5}]
    made["vertices"] = [[{"D": [[0.4]], "G": [[0.0]]}]] * 4
    return {**made, **changes}


def constrained(**changes: Any) -> Evidence:
    """Return evidence of the same gain with a function between 0 and q in place of the parameter."""
    block = {"name": "cut", "size": 1, "kind": "sector", "T": [0.4]}
    return {**gain(kind="constrained gain", blocks=[block]), "stability": [[1.0]], **changes}


def part(evidence: Evidence, **changes: Any) -> Evidence:
    evidence["blocks"][0].update(changes)
    return evidence


@lru_cache
def _flight() -> str:
    return json.dumps(certify_boundedness("flagship", "paper", moment=(0.65, 0.65, 0.3), horizon=60.0).evidence)


def flight(**changes: Any) -> Evidence:
    return {**json.loads(_flight()), **changes}


def renamed(evidence: Evidence, old: str, new: str) -> Evidence:
    return {new if key == old else key: value for key, value in evidence.items()}


def sealed(evidence: Any, **beside: Any) -> str:
    document = {"format": "gustproof-certificate-1", "evidence": evidence, **beside}
    return json.dumps({**document, "seal": seal(document)})


def check(text: str, **files: Any) -> CheckResult:
    """Return the verdict, which takes less than a second of this process whatever the text is."""
    start = time.process_time()
    verdict = check_certificate(text, **files)
    assert time.process_time() - start < 5.0  # under coverage; 1 s is far off without
    return verdict


def check_flight(text: str) -> CheckResult:
    return check(text, law=LAW, vehicle=VEHICLE)


def bound_to(law: str = LAW, vehicle: str = VEHICLE) -> CheckResult:
    """Return the verdict on the box of `flagship` and `paper`, bound to other texts."""
    evidence = flight(law_sha256=sha256(law), vehicle_sha256=sha256(vehicle))
    return check(sealed(evidence), law=law, vehicle=vehicle)


def test_what_is_forged_below_is_accepted_as_it_was() -> None:
    for evidence in (gain(), slow(), constrained()):
        assert check(sealed(evidence)).accepted
    assert bound_to().accepted


LOOP = DerivedLoop(SYSTEM, [("rate", 1)], [None], [{}])
FILES: dict[str, tuple[Callable[[], str], dict[str, Any]]] = {
    f"{kind} with {', '.join(given)}": (partial(make, evidence), given)
    for make in (lambda evidence: sealed(evidence()),)
    for kind, evidence in {"gain": gain, "slow gain": slow, "constrained gain": constrained}.items()
    for given in (
        {"law": LAW},
        {"vehicle": VEHICLE},
        {"scenario": SCENARIO},
        {"law": LAW, "vehicle": VEHICLE},
        {"law": LAW, "loop": LOOP},
    )
} | {
    "flight with scenario": (lambda: sealed(flight()), {"law": LAW, "vehicle": VEHICLE, "scenario": SCENARIO}),
    "flight with a design": (lambda: sealed(flight()), {"law": LAW, "vehicle": VEHICLE, "loop": LOOP}),
    "chance with a design": (lambda: sealed({"kind": "chance"}), {"law": LAW, "vehicle": VEHICLE, "loop": LOOP}),
    "flight without its law": (lambda: sealed(flight()), {"vehicle": VEHICLE}),
    "flight without its vehicle": (lambda: sealed(flight()), {"law": LAW}),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_the_proof_is_not_bound_to_is_refused(name: str) -> None:
    make, given = FILES[name]
    verdict = check(make(), **given)
    assert not verdict.accepted
    assert re.search("bound to no such file|not about the gain|give both", verdict.reason)


NAMES = [
    *("any\u3164gust", "rate\ua4f9", "rate\ua4fd", "r\u115fate", "r\u0430te", "\u03c1", "ra\u200bte", "rate\u202eetar"),
    *(
        "r\u00e4te",
        "rate\u0301",
        "\u4e00",
        "\uff52ate",
        "rate\u00a0",
        "rate\n",
        "rate\x00",
        "\ud800",
        "rate\u2024",
        "\u0661",
    ),
    *("rate for ever", "rate:", "rate,", "'rate'", "(rate)", "rate=1", "<=.01", ".01", "-rate", "1e-6", "_", "", " "),
    *("r" * 33, None, 1, True, ["rate"], {"rate": 1}),
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("make", [gain, constrained])
def test_a_name_of_look_alikes_makes_no_statement(make: Callable[[], Evidence], name: Any) -> None:
    verdict = check(sealed(part(make(), name=name)))
    assert not verdict.accepted
    assert verdict.reason.isascii()


@pytest.mark.parametrize(
    "name", ["fl\u0430gship", "any\u3164gust", "\u98de", "flagship\ua4f9", "flagship.", "flag ship"]
)
def test_a_laws_name_in_any_script_is_written_in_ascii(name: str) -> None:
    verdict = bound_to(law=json.dumps({**json.loads(LAW), "name": name}))
    assert verdict.accepted
    assert verdict.reason.isascii()
    assert f", law '{ascii(name)[1:-1]}' keeps its own attitude" in verdict.reason
    assert "law 'flagship' keeps" not in verdict.reason


def law_with(**changes: Any) -> str:
    return json.dumps({**json.loads(LAW), **changes})


def scaled(name: str, factor: float) -> str:
    return law_with(**{name: [[factor * value for value in row] for row in json.loads(LAW)[name]]})


LAWS: dict[str, str] = {
    "a quote ends the name": law_with(name="f' keeps all"),
    "a backslash forges an escape": law_with(name="fl\\u0430gship"),
    "a name of two lines": law_with(name="f\nproven"),
    "a name from right to left": law_with(name="f\u202eproven"),
    "a name as long as a sentence": law_with(
        name="flagship keeps its own attitude within a tenth of a degree for ever x"
    ),
    "no name": law_with(name=None),
    "another format": law_with(format="gustproof-law-2"),
    "no format": json.dumps({key: value for key, value in json.loads(LAW).items() if key != "format"}),
    "a delay of its own": law_with(delay_samples=3),
    "a notch": law_with(notch={"frequency_hz": 30.0}),
    "a look-alike of a key": law_with(**{"\u0410": [[0.0]]}),
    "C twice": LAW.replace('"C":', '"C": [[0.0]], "C":', 1),
    "name twice": LAW.replace('"name":', '"name": "sound", "name":', 1),
    "time step in milliseconds": law_with(dt=4.0),
    "half the time step": law_with(dt=0.002),
    "twice the time step": law_with(dt=0.008),
    "gyro in degrees": scaled("B", 57.29577951308232),
    "commands in N mm": scaled("C", 1000.0),
    "commands of the other sign": scaled("C", -1.0),
    "commands off": scaled("C", 0.0),
    "limits in N mm": law_with(limits=[10.0 / 1000.0] * 3),
    "rates for torques": law_with(output="rates"),
    "motors for torques": law_with(output="motors"),
    "an empty schedule": law_with(schedule={}),
    "limits of no size": law_with(limits=[0.0] * 3),
    **{
        f"made for {made_for!a:.20}": law_with(provenance={**json.loads(LAW)["provenance"], "vehicle": made_for})
        for made_for in (
            ["paper"],
            "paper\nproven",
            "paper\x1b[2K",
            "p\u202eaper",
            "p\\u0430per",
            "paper in any gust " * 9,
        )
    },
    "axes exchanged": law_with(C=json.loads(LAW)["C"][::-1]),
    "other law": law_path("pid-fair").read_text(encoding="utf-8"),
    "other law of this name": json.dumps(
        {**json.loads(law_path("pid-fair").read_text(encoding="utf-8")), "name": "flagship"}
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_of_another_meaning_is_not_proved_by_the_box(name: str) -> None:
    assert not bound_to(law=LAWS[name]).accepted


def vehicle_with(old: str, new: str) -> str:
    assert old in VEHICLE
    return VEHICLE.replace(old, new, 1)


def gyro_with(line: str) -> str:
    return re.sub(r"(?ms)^bias_B = \[.*?^\]\n|^bias_B = [^\n]*\n", "", VEHICLE, count=1).replace(
        "[gyro]\n", f"[gyro]\n{line}\n", 1
    )


VEHICLES: dict[str, tuple[str, str]] = {
    "command later than a sample": (
        f'{VEHICLE}\n[command]\nautopilot = "px4"\nfull_scale = "measured"\ndelay = 0.003\n',
        "beside one sample",
    ),
    "command half a sample later": (
        f'{VEHICLE}\n[command]\nautopilot = "px4"\nfull_scale = "measured"\ndelay = 0.0019\n',
        "beside one sample",
    ),
    "lag in a unit": (vehicle_with("nominal = 0.05", 'unit = "ms", nominal = 0.05'), "must be one of low"),
    "inertia of a share": (vehicle_with("nominal = 0.25", "share = 0.5, nominal = 0.25"), "must be one of low"),
    "inertia without a low end": (vehicle_with("nominal = 0.25, low = 0.2", "nominal = 0.25"), "must be one of low"),
    "inertia from high to low": (
        vehicle_with("nominal = 0.25, low = 0.2, high = 0.3", "nominal = 0.25, low = 0.3, high = 0.2"),
        "needs low < nominal < high",
    ),
    "bias of roll": (gyro_with("bias_B = [0.02, 0.0, 0.0]"), "gyro has a bias"),
    "bias of yaw, small": (gyro_with("bias_B = [0.0, 0.0, 1e-12]"), "gyro has a bias"),
    "bias within a spread": (
        gyro_with("bias_B = [0.0, { nominal = -1e-3, low = -2e-3, high = 0.0 }, 0.0]"),
        "gyro has a bias",
    ),
    "bias in words": (gyro_with('bias_B = ["0", 0.0, 0.0]'), "finite number"),
    "bias of no end": (gyro_with("bias_B = [nan, 0.0, 0.0]"), "finite number"),
    "late gyro": (gyro_with("delay = 0.02"), "gyro.delay"),
    "gyro mounted askew": (gyro_with("misalignment = [0.0, 0.1, 0.0]"), "gyro.misalignment"),
    "drifting gyro": (gyro_with("random_walk = 1e-3"), "gyro.random_walk"),
    "payload": ("payload = 2.0\n" + VEHICLE, "payload"),
    "late actuators": ("actuator_delay = 0.05\n" + VEHICLE, "actuator_delay"),
    "inertia of look-alikes": ('"inerti\u0430_B" = [1.0, 1.0, 1.0]\n' + VEHICLE, "does not know"),
    "flexible arms": (VEHICLE + "\n[arms]\nfrequency_hz = 12.0\n", "arms.frequency_hz"),
    "products of inertia": ("inertia_xy = 0.01\n" + VEHICLE, "inertia_xy"),
    "inertia in kg cm^2": (vehicle_with("nominal = 0.25, low = 0.2", "nominal = 2500.0, low = 2000.0"), ""),
    "inertia a fifth lower": (vehicle_with("nominal = 0.25, low = 0.2", "nominal = 0.2, low = 0.15"), "not close"),
    "lag in milliseconds": (vehicle_with("nominal = 0.05", "nominal = 50.0"), ""),
    "lag a fifth longer": (vehicle_with("nominal = 0.05", "nominal = 0.06"), "not close"),
    "torque limit in N cm": (
        vehicle_with("torque_limit = [10.0, 10.0, 10.0]", "torque_limit = [0.1, 0.1, 0.1]"),
        "may reach its limit",
    ),
    "range of the gyro in turns": (vehicle_with("range = 34.9", "range = 0.0969"), "range"),
    "damping of the other sign": (vehicle_with("rate_damping = 0.02", "rate_damping = -0.02"), "negative"),
    "inertia true": (vehicle_with("{ nominal = 0.25, low = 0.2, high = 0.3 }", "true"), "finite number"),
    "two axes": (vehicle_with("    { nominal = 0.25, low = 0.2, high = 0.3 },\n", ""), "3 positive numbers"),
    "no lag": (vehicle_with("nominal = 0.05", "nominal = 0.0"), "low < nominal"),
    "iris": (vehicle_path("iris").read_text(encoding="utf-8"), ""),
}


@pytest.mark.parametrize("name", VEHICLES)
def test_a_vehicle_of_another_meaning_is_not_proved_by_the_box(name: str) -> None:
    text, reason = VEHICLES[name]
    verdict = bound_to(vehicle=text)
    assert not verdict.accepted
    assert reason in verdict.reason


def swapped(first: str, second: str) -> Evidence:
    made = flight()
    return {**made, first: made[second], second: made[first]}


FLIGHTS: dict[str, Callable[[], str]] = {
    "moment in N mm": lambda: sealed(flight(moment=[650.0, 650.0, 300.0])),
    "moment in words": lambda: sealed(flight(moment=["0.65", "0.65", "0.3"])),
    "moment of one number": lambda: sealed(flight(moment=0.65)),
    "moment by axis": lambda: sealed(flight(moment={"x": 0.65, "y": 0.65, "z": 0.3})),
    "moment about other axes": lambda: sealed(flight(moment=[0.3, 0.65, 0.65])),
    "moment of the other sign": lambda: sealed(flight(moment=[-0.65, 0.65, 0.3])),
    "part in percent": lambda: sealed(flight(part=100.0)),
    "part of nothing": lambda: sealed(flight(part=0.0)),
    "part true": lambda: sealed(flight(part=True)),
    "part denormal below nothing": lambda: sealed(flight(part=-5e-324)),
    "horizon in milliseconds": lambda: sealed(flight(horizon=6e7)),
    "horizon of nothing": lambda: sealed(flight(horizon=0)),
    "horizon for ever in words": lambda: sealed(flight(horizon="for ever")),
    "horizon false": lambda: sealed(flight(horizon=False)),
    "inertia spread in percent": lambda: sealed(flight(inertia_spread=20.0)),
    "inertia spread of a calm box": lambda: sealed(flight(inertia_spread=0.2)),
    "lag spread of a calm box": lambda: sealed(flight(lag_spread=0.3)),
    "noise of a calm box": lambda: sealed(flight(noise=0.0036, risk=1e-3)),
    "noise for risk": lambda: sealed(flight(noise=1e-3, risk=0.0036)),
    "risk without noise": lambda: sealed(flight(risk=1e-3)),
    "risk in percent": lambda: sealed(flight(noise=1e-9, risk=1.0)),
    "law for vehicle": lambda: sealed(swapped("law_sha256", "vehicle_sha256")),
    "samples for cells": lambda: sealed(swapped("samples", "cells")),
    "moment for slope": lambda: sealed(swapped("moment", "slope")),
    "moment for a row of the box": lambda: sealed(swapped("moment", "box")),
    "part for horizon": lambda: sealed(swapped("part", "horizon")),
    "axes of the box exchanged": lambda: sealed(flight(box=flight()["box"][::-1])),
    "signals of the box exchanged": lambda: sealed(flight(box=[row[::-1] for row in flight()["box"]])),
    "box in degrees": lambda: sealed(flight(box=[[57.3 * value for value in row] for row in flight()["box"]])),
    "box of nothing": lambda: sealed(flight(box=[[0.0] * 13] * 3)),
    "box of an axis": lambda: sealed(flight(box=flight()["box"][:1])),
    "box of long rows": lambda: sealed(flight(box=[[0.1] * 100_000] * 3)),
    "kind in capitals": lambda: sealed(flight(kind="Boundedness")),
    "kind with a space": lambda: sealed(flight(kind="boundedness ")),
    "kind of look-alikes": lambda: sealed(flight(kind="b\u043eundedness")),
    "called a chance": lambda: sealed(flight(kind="chance")),
    "called a slow gain": lambda: sealed(flight(kind="slow gain")),
    "kinds": lambda: sealed(flight(kind=["boundedness"])),
    "a key of look-alikes": lambda: sealed(renamed(flight(), "moment", "m\u043ement")),
    "a key in capitals": lambda: sealed(renamed(flight(), "horizon", "Horizon")),
    "a key with its unit": lambda: sealed(renamed(flight(), "moment", "moment_N_m")),
    "a key in another unit": lambda: sealed(renamed(flight(), "horizon", "horizon_min")),
    "a key left out": lambda: sealed({key: value for key, value in flight().items() if key != "slope"}),
    "a statement": lambda: sealed(flight(statement="for ever")),
    "a law's name": lambda: sealed(flight(law="sound")),
    "a vehicle's name": lambda: sealed(flight(vehicle="iris")),
    "a delay": lambda: sealed(flight(delay_samples=5)),
    "a bias": lambda: sealed(flight(bias_B=[0.02, 0.0, 0.0])),
    "units": lambda: sealed(flight(units={"moment": "kN m"})),
    "a time step": lambda: sealed(flight(dt=0.02)),
    "a statement beside": lambda: sealed(flight(), statement="for ever"),
    "proven beside": lambda: sealed(flight(), proven=True),
    "evidence in evidence": lambda: sealed({"evidence": flight()}),
    "evidence in a list": lambda: sealed([flight()]),
    "evidence as text": lambda: sealed(json.dumps(flight())),
    "no evidence": lambda: sealed(None),
    "part twice, the same": lambda: sealed(flight()).replace('"part": 1.0', '"part": 1.0, "part": 1.0'),
    "seal twice": lambda: sealed(flight()).replace('"seal"', '"seal": "", "seal"'),
    "another version": lambda: sealed(flight()).replace("certificate-1", "certificate-2"),
    "a byte order mark": lambda: "\ufeff" + sealed(flight()),
    "words before": lambda: "proven " + sealed(flight()),
    "samples without end": lambda: sealed(flight(samples=10**18)),
    "samples of nothing": lambda: sealed(flight(samples=0)),
    "samples broken": lambda: sealed(flight(samples=512.0)),
    "cells without end": lambda: sealed(flight(cells=[10**9, 10**9])),
    "cells of nothing": lambda: sealed(flight(cells=[0, 1])),
    "a class of its own": lambda: sealed(flight(moment_class="calm")),
    "a slope of another class": lambda: sealed(flight(slope=[1.0, 1.0, 1.0])),
    "a slope class without slope": lambda: sealed(flight(moment_class="slope")),
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_flight_of_another_meaning_is_refused(name: str) -> None:
    assert not check_flight(FLIGHTS[name]()).accepted


def system(**changes: Any) -> Evidence:
    return gain(system={**SYSTEM, **changes})


GAINS: dict[str, tuple[Callable[[], Evidence], str]] = {
    "level in percent of itself": (lambda: gain(level=0.02), "does not hold"),
    "level in decibels": (lambda: gain(level=-6.0), "not positive"),
    "level in words": (lambda: gain(level="2"), "finite number"),
    "level of no end": (lambda: gain(level=10**400), "malformed"),
    "level of a list": (lambda: gain(level=[2.0]), "finite number"),
    "two blocks of a name": (lambda: gain(blocks=gain()["blocks"] * 2), "same name"),
    "more blocks than channels": (
        lambda: gain(blocks=[*gain()["blocks"], {**gain()["blocks"][0], "name": "b", "size": 2}]),
        "more than the system",
    ),
    "a block of two hundred thousand": (lambda: part(constrained(), size=200_000), "more than the system"),
    "a delay of two hundred thousand": (
        lambda: part(constrained(), kind="delay", size=200_000, largest=1.0, poles=[], X=[], Y=[]),
        "more than the system",
    ),
    "twenty thousand poles": (
        lambda: constrained(
            blocks=[
                {"name": "d", "size": 1, "kind": "slope", "odd": False, "poles": [1.0] * 20_000, "T": [1.0]}
                | {"causal": [], "anticausal": []}
            ]
        ),
        "does not have its size",
    ),
    "twenty thousand poles and multipliers": (
        lambda: constrained(
            blocks=[
                {"name": "d", "size": 1, "kind": "slope", "odd": False, "poles": [1.0] * 20_000, "T": [1.0]}
                | {"causal": [[0.0]] * 20_000, "anticausal": [[0.0]] * 20_000}
            ]
        ),
        "more than 400",
    ),
    "a system of ten thousand": (lambda: system(A=[[0.0]] * 10_000), "more than 400"),
    "a system of no columns": (lambda: system(D=[]), "malformed"),
    "another matrix": (lambda: system(E=[[1.0]]), "other entries"),
    "a matrix of look-alikes": (lambda: gain(system=renamed(SYSTEM, "A", "\u0410")), "other entries"),
    "matrix left out": (lambda: gain(system={key: SYSTEM[key] for key in "ABC"}), "other entries"),
    "a truth for a number": (lambda: system(C=[[True], [True]]), "'true' or 'false'"),
    "a truth in D": (lambda: part(gain(), D=[[True]]), "'true' or 'false'"),
    "inputs for outputs": (lambda: system(B=SYSTEM["C"], C=SYSTEM["B"]), "wrong shapes"),
    "disturbance off": (lambda: gain(system={**SYSTEM, "C": [[1.0], [9.0]]}), "does not hold"),
    "sign of A": (lambda: system(A=[[1.0]]), "does not hold"),
    "numbers in words": (lambda: system(A=[["-1.0"]]), "malformed"),
    "P of the other sign": (lambda: gain(P=[[-1.5]]), "not positive definite"),
    "P of nothing": (lambda: gain(P=[]), "malformed|not hold|definite"),
    "D of the other sign": (lambda: part(gain(), D=[[-0.4]]), "not positive definite"),
    "G that is not skew": (lambda: part(gain(), G=[[0.1]]), "not skew"),
    "D of another size": (lambda: part(gain(), D=[[0.4, 0.0], [0.0, 0.4]]), "its size"),
    "a speed beside": (lambda: part(gain(), speed=0.0), "other entries"),
    "a kind beside": (lambda: part(gain(), kind="real"), "other entries"),
    "a unit beside": (lambda: part(gain(), unit="deg"), "other entries"),
    "a law's name beside": (lambda: gain(law="flagship"), "other entries"),
    "a design's name beside": (lambda: gain(design="D2"), "other entries"),
    "a slow one called fast": (lambda: {**slow(), "kind": "gain"}, "other entries"),
    "a fast one called slow": (lambda: {**gain(), "kind": "slow gain"}, "other entries"),
    "a sector called a parameter": (lambda: {**constrained(), "kind": "gain"}, "other entries"),
    "faster than proved": (lambda: slow(blocks=[{"name": "rate", "size": 1, "speed": -0.5}]), "negative"),
    "speed in words": (lambda: slow(blocks=[{"name": "rate", "size": 1, "speed": "0.5"}]), "finite number"),
    "speed true": (lambda: slow(blocks=[{"name": "rate", "size": 1, "speed": True}]), "true"),
    "speed without end": (lambda: slow(blocks=[{"name": "rate", "size": 1, "speed": 10**400}]), "malformed"),
    "a vertex less": (lambda: slow(vertices=slow()["vertices"][:3]), "malformed"),
    "a slow parameter too many": (
        lambda: slow(blocks=[{"name": f"p{k}", "size": 1, "speed": 1.0} for k in range(60)]),
        "more than the system",
    ),
    "T of the other sign": (lambda: part(constrained(), T=[-0.4]), "not positive"),
    "T of two": (lambda: part(constrained(), T=[0.4, 0.4]), "its size"),
    "a sector called a slope": (lambda: part(constrained(), kind="slope"), "other entries"),
    "a sector called a parameter of the loop": (lambda: part(constrained(), kind="real"), "other entries"),
    "a kind of look-alikes": (lambda: part(constrained(), kind="s\u0435ctor"), "unknown kind"),
    "an impulse of two channels": (
        lambda: constrained(
            blocks=[
                {"name": "d", "size": 1, "kind": "slope", "odd": False, "poles": [1.0], "T": [0.4]}
                | {"causal": [[0.0, 0.0]], "anticausal": [[0.0]]}
            ],
            **{key: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] for key in ("coordinates", "P", "stability")},
        ),
        "size of poles and channels",
    ),
    "stability of nothing": (lambda: constrained(stability=[[0.0]]), "not positive definite"),
}


@pytest.mark.parametrize("name", GAINS)
def test_a_gain_of_another_meaning_is_refused(name: str) -> None:
    make, reason = GAINS[name]
    verdict = check(sealed(make()))
    assert not verdict.accepted
    assert re.search(reason, verdict.reason)
    assert verdict.reason.isascii()


def test_what_does_not_fit_into_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def run_out(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("gustproof.checker.evidence.gain_inequality", run_out)
    assert check(sealed(gain())).reason == "the evidence is larger than the memory"


def test_a_gain_says_that_it_is_bound_to_nothing_or_to_what() -> None:
    alone, bound = check(sealed(gain())), check(sealed(gain()), loop=LOOP)
    assert alone.accepted
    assert "the system in this certificate" in alone.reason
    assert "bound to no design or law" in alone.assumes["plant"]
    assert bound.accepted
    assert "the derived loop" in bound.reason
    assert "bound to no" not in bound.assumes["plant"]


LEVELS = [2.603653010825, 2.0000001, 1.9999999, 0.3, 1e-6, 1.23456789e-7, 123456789.5, 1e22, 5e-324, 1.7e308, 1 / 3]


@pytest.mark.parametrize("value", LEVELS)
def test_a_printed_bound_is_never_below_and_an_assumption_never_above_the_number(value: float) -> None:
    for digits in (2, 3, 6):
        assert float(print_up(value, digits)) >= value >= float(print_down(value, digits))
    assert float(list_up([value])) >= value >= float(list_down([value]))
    assert float(percent_down(value)) <= math.nextafter(100.0 * value, math.inf)


def test_decimals_that_were_typed_are_printed_as_they_were() -> None:
    for text in ("0.65", "0.3", "60", "0.001", "1.5", "0.0036", "0"):
        assert print_up(float(text)) == print_down(float(text)) == list_down([float(text)]) == text
    assert [percent_down(share) for share in (0.29, 0.07, 0.2, 1.0)] == ["29", "7", "20", "100"]
    assert list_up([1234.5611, 0.0001]) == "1234.562, 0.001"


def test_statements_round_levels_up_and_assumptions_down() -> None:
    stated = check(sealed(gain(level=2.603653010825))).reason
    assert "below 2.60366 for" in stated
    level = float(re.findall(r"below ([\d.]+) for", stated)[0])
    assert check(sealed(gain(level=level))).accepted
    assert "'rate' below 0.499999 1/s" in check(sealed(part(slow(), speed=0.4999996))).reason
    moment = [0.64995149, 0.64995149, 0.29995149]
    found = check_flight(sealed(flight(moment=moment, horizon=59.99999949)))
    assert "within 0.649951, 0.649951, 0.299951 N*m" in found.reason
    assert "for 59.9999 s" in found.reason
    assert found.assumes["moment_N_m"] == moment


def test_a_part_of_the_moment_is_assumed_and_not_what_was_asked() -> None:
    found = check_flight(sealed(flight(moment=[650.0, 650.0, 300.0], part=0.000999)))
    assert found.accepted
    assert found.assumes["moment_N_m"] == pytest.approx([0.64935, 0.64935, 0.2997])
    assert found.assumes["moment_asked_N_m"] == [650.0, 650.0, 300.0]
    assert "within 0.64935, 0.64935, 0.2997 N*m" in found.reason


def iter_fields(kind: Any, prefix: str = "") -> Any:
    """Yield the dotted names of the fields of a vehicle file."""
    for name, hint in get_type_hints(kind).items():
        if name not in {field.name for field in fields(kind)}:
            continue
        inner = next((arm for arm in get_args(hint) if is_dataclass(arm)), hint)
        union = get_origin(hint) in (Union, UnionType)
        yield from iter_fields(inner, f"{name}.") if is_dataclass(inner if union else hint) else [prefix + name]


def test_each_field_of_a_vehicle_file_has_a_use_in_the_proofs() -> None:
    """A new field must be decided: used, stated, refused or idle."""
    names = set(iter_fields(Vehicle))
    assert "gyro.bias_B" in names
    whole = {name for name in VEHICLE_FIELDS if "." not in name}
    assert {name for name in names if name not in VEHICLE_FIELDS and name.split(".")[0] not in whole} == set()
    assert {
        name for name in VEHICLE_FIELDS if name not in names and not any(n.startswith(f"{name}.") for n in names)
    } == set()


def test_each_key_of_a_law_file_is_known_to_the_proofs() -> None:
    assert {
        key for name in ("flagship", "hinf-scheduled", "aided", "hinf-rates") for key in load_law(name).to_dict()
    } | {"schedule"} == LAW_KEYS


@pytest.mark.parametrize(
    "name", [name for name, use in VEHICLE_FIELDS.items() if use is Use.IDLE and name != "battery"]
)
def test_a_field_that_is_idle_on_a_stand_does_not_change_the_proof(name: str) -> None:
    assert name.split(".")[0] in Vehicle.__annotations__


def test_what_a_proof_leaves_out_of_the_vehicle_file_is_listed() -> None:
    def left(**changes: Any) -> list[str]:
        nothing = {"inertia": 0.0, "lag": 0.0, "noise": 0.0, "dt": 0.004, "gravity_aided": False}
        return list_uncovered(VEHICLE, **{**nothing, **changes})

    assert left()[:2] == ["spread of inertia_B", "spread of actuator_lag"]
    assert left()[-1] == "noise of the gyro"
    assert left(inertia=0.2, lag=0.3, noise=0.01) == ["spread of gyro.bias_B"]
    late = f"{VEHICLE}\n[command]\ndelay = 0.0009\n"
    left_out = list_uncovered(late, inertia=1, lag=1, noise=9.0, dt=0.004, gravity_aided=False)
    assert left_out[-1].startswith("command.delay")
    assert left(noise=0.0036)[-1] == "spread of the gyro's noise"
    assert "noise of the accelerometer" in left(gravity_aided=True)
    assert "spread of gyro.snr_db" in left(noise=None)
    state = VEHICLE.replace("[gyro]\n", '[gyro]\nnoise_model = "state-dependent"\n')
    assert "noise of the gyro" in list_uncovered(state, inertia=0.0, lag=0.0, noise=9.0, dt=0.004, gravity_aided=False)
    bare = VEHICLE.replace("rate_damping = 0.02", "").replace(
        "gust_gain = 0.0763", "gust_gain = { nominal = 0.0763, low = 0.05, high = 0.1 }"
    )
    assert "spread of gust_gain" in list_uncovered(bare, inertia=0, lag=0, noise=0, dt=0.004, gravity_aided=False)
