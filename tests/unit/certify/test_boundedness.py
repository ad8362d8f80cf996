"""Boxes that flights provably keep: flown against, spoiled, and refused where they do not close."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.scenario import GyroFault, Scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import MomentSine, MomentSquare
from gustproof.certify.boundedness import certify_boundedness
from gustproof.certify.certificate import Certificate, load_certificate
from gustproof.certify.check.evidence import check_certificate as check
from gustproof.certify.check.evidence import seal
from gustproof.certify.check.invariant_box import SIGNALS, axis_norms
from gustproof.law.form import Law, load_law
from gustproof.law.step import step
from gustproof.scoring.metrics import attitude
from gustproof.simulate.direct import fly_direct

VEHICLE = load_vehicle("paper")
GOLDEN = Path(__file__).parents[2] / "golden"
MOMENT = (0.65, 0.65, 0.3)
HORIZON = 2.0
"""[s] of the fixture."""


@pytest.fixture
def certificate(closure) -> Certificate:
    return closure


def excess(E, omega):
    turn = (np.sin(E[0]) * omega[1] + np.cos(E[0]) * omega[2]) / np.cos(E[1])
    return np.array(
        [np.sin(E[1]) * turn, np.cos(E[0]) * omega[1] - np.sin(E[0]) * omega[2] - omega[1], turn - omega[2]]
    )


def flown(law: Law, moments, substeps: int = 4):
    """Return the largest moduli of E, omega and command of a flight, by Euler's equations in Runge-Kutta steps."""
    inertia, lag = np.array(VEHICLE.inertia_B), VEHICLE.actuator_lag

    def derivative(s, u, d):
        E, omega, torque = s[:3], s[3:6], s[6:]
        turn = (torque + d - np.cross(omega, inertia * omega)) / inertia - VEHICLE.rate_damping * omega
        return np.concatenate([omega + excess(E, omega), turn, (u - torque) / lag])

    s, x, last = np.zeros(9), np.zeros(9), np.zeros(3)
    largest = np.zeros((3, 3))
    h = law.dt / substeps
    for d in moments:
        x, command = step(law, x, np.concatenate([s[3:6], np.zeros(3)]))
        for _ in range(substeps):
            a = derivative(s, last, d)
            b = derivative(s + h / 2 * a, last, d)
            c = derivative(s + h / 2 * b, last, d)
            s = s + h / 6 * (a + 2 * b + 2 * c + derivative(s + h * c, last, d))
            largest = np.maximum(largest, np.abs([s[:3], s[3:6], command]))
        last = command
    return largest


def test_a_box_is_proven_and_accepted_again(certificate):
    assert certificate.proven
    assert certificate.gain is not None
    assert 0.05 < certificate.gain <= 1.0
    assert certificate.residual > 0.0
    assert check(json.dumps(certificate.to_dict())).accepted


@pytest.mark.compiled
def test_no_flight_within_the_moment_leaves_the_box_and_the_worst_come_near(certificate):
    law, rng = load_law("hinf-scheduled"), np.random.default_rng(2)
    box = np.array(certificate.evidence["box"])
    bound = box[:, [SIGNALS.index(name) for name in ("E", "omega", "command")]].T
    samples = round(HORIZON / law.dt)
    time = law.dt * np.arange(samples)[:, None]
    reached = np.zeros((3, 3))
    for rate in (0.0, 3.0, 12.0, 20.0, 40.0):
        shape = np.cos(rate * time + rng.uniform(0.0, 6.0, 3)) if rate else np.ones((samples, 3))
        reached = np.maximum(reached, flown(law, certificate.gain * np.array(MOMENT) * np.sign(shape)))
    assert np.all(reached <= bound)
    assert np.all(reached[1] >= 0.5 * bound[1])  # bang-bang torque near the crossover comes close in the rates


@pytest.mark.compiled
def test_no_flight_of_ten_thousand_leaves_the_box(certificate):
    law, rng = load_law("hinf-scheduled"), np.random.default_rng(7)
    calm = Scenario(name="random", description="moments at random", duration_s=0.6, gyro=GyroFault(noise=False))
    limits = certificate.gain * np.array(MOMENT)
    reached = np.zeros((3, 3))
    for _ in range(10_000):
        moments = []
        for axis in range(3):
            rate, phase = float(np.exp(rng.uniform(np.log(0.3), np.log(60.0)))), float(rng.uniform(0.0, 2.0 * np.pi))
            wave, amplitude = (
                (MomentSine, MomentSquare)[int(rng.integers(2))],
                tuple((limits * np.eye(3)[axis]).tolist()),
            )
            kind = "sine" if wave is MomentSine else "square"
            moments.append(wave(kind=kind, amplitude_nm=amplitude, rate_rad_s=rate, phase_rad=phase))
        records = fly_direct(replace(calm, moment=tuple(moments)), law, vehicle=VEHICLE)
        signals = (attitude(records), records["omega_B"], records["torque_command_B"])
        reached = np.maximum(reached, [np.max(np.abs(signal), axis=0) for signal in signals])
    box = np.array(certificate.evidence["box"])
    bound = box[:, [SIGNALS.index(name) for name in ("E", "omega", "command")]].T
    assert np.all(reached <= bound)
    assert np.all(bound[2] <= VEHICLE.torque_limit)
    assert np.all(reached[1:] >= 0.9 * bound[1:])  # they came near enough to have refuted a false box


def test_nothing_is_flown_for_a_proof(certificate):
    assert certificate.lower_bound == 0.0


def test_without_leak_the_attitude_integrates_what_turns_it(certificate):
    norms = axis_norms(certificate.evidence, 2)
    assert float(norms.attitude[SIGNALS.index("E")]) == pytest.approx(HORIZON)
    assert float(norms.attitude[SIGNALS.index("omega")]) == 0.0  # no gyro sees it


def test_with_leak_the_attitude_forgets_what_turned_it():
    law, leak, horizon = load_law("hinf-d2"), 0.5, 1.0
    leaky = certify_boundedness(law, VEHICLE, moment=MOMENT, horizon=horizon, leak=leak)
    assert leaky.proven
    assert check(json.dumps(leaky.to_dict())).accepted
    kept = float(axis_norms(leaky.evidence, 2).attitude[SIGNALS.index("E")])
    assert kept == pytest.approx(law.dt * math.expm1(-leak * horizon) / math.expm1(-leak * law.dt), rel=1e-9)


def test_noise_is_covered_with_its_probability(certificate):
    noisy = certify_boundedness(load_law("hinf-d2"), VEHICLE, moment=MOMENT, horizon=0.5, noise=0.001, risk=1e-3)
    assert noisy.proven
    assert noisy.assumes["noise_probability"] == 1e-3
    assert not spoiled(noisy, ("evidence", "risk"), 1e-6).accepted


def spoiled(certificate, path, value):
    document = json.loads(json.dumps(certificate.to_dict()))
    del document["seal"]
    place = document
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return check(json.dumps({**document, "seal": seal(document)}))


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        (("gain",), 3.0, "does not close"),
        (("gain",), 0.0, "not positive"),
        (("evidence", "box", 0, 0), 0.0, "does not close"),
        (("evidence", "box"), [[1.0]] * 3, "does not bound every signal"),
        (("evidence", "law", "limits", 2), 1e-3, "may reach its limit"),
        (("evidence", "law", "dt"), 0.2, "malformed"),
        (("evidence", "samples"), 10**12, "samples are 1000000000000, must be 1 to 90000"),
        (("evidence", "law", "A", 0, 0), 1e200, "the loop is unstable"),
        (("evidence", "vehicle", "actuator_lag"), 0.2, "does not close"),
    ],
)
def test_a_false_box_is_refused_even_with_a_new_seal(certificate, path, value, reason):
    verdict = spoiled(certificate, path, value)
    assert not verdict.accepted
    assert reason in verdict.reason


def test_a_law_of_another_form_or_a_senseless_number_is_refused():
    with pytest.raises(ValueError, match="torque laws with 9 states"):
        certify_boundedness(load_law("pid-fair"), VEHICLE, moment=MOMENT, horizon=HORIZON)
    with pytest.raises(ValueError, match="must be positive"):
        certify_boundedness(load_law("hinf-d2"), VEHICLE, moment=MOMENT, horizon=0.0)


@pytest.mark.parametrize("factor", [1.001, 2.0, 1e200])
def test_an_unstable_law_is_refused_before_its_numbers_grow_long(factor):
    with pytest.raises(ValueError, match="the loop is unstable"):
        certify_boundedness(replace(load_law("hinf-d1"), A=factor * np.eye(9)), VEHICLE, moment=MOMENT, horizon=360.0)


def test_of_a_moment_too_large_the_largest_part_is_found():
    law = load_law("hinf-scheduled")
    part = certify_boundedness(law, VEHICLE, moment=(13.0, 13.0, 6.0), horizon=0.5)
    assert part.proven
    assert part.gain is not None
    assert 0.1 < part.gain < 1.0
    wider = spoiled(part, ("gain",), 1.02 * part.gain)
    assert "does not close" in wider.reason  # its box is the least
    assert 0.98 * law.limits[1] < part.evidence["box"][1][SIGNALS.index("command")] < law.limits[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "file", "leak", "least"),
    [("hinf-d2", "closure_d2_leak.json", 0.05, 0.1), ("hinf-scheduled", "closure_scheduled_60s.json", 0.0, 0.039)],
)
def test_the_certificates_of_a_minute_are_accepted_and_of_the_shipped_laws(name, file, leak, least):
    """Found once, by `gustproof certify NAME --closure`, D2 with `--leak 0.05`; the other is of the true vehicle."""
    certificate, law = load_certificate(GOLDEN / file), load_law(name)
    assert check((GOLDEN / file).read_text()).accepted
    assert certificate.gain >= least
    assert certificate.lower_bound < 1.0
    assert (certificate.assumes["horizon_s"], certificate.assumes["leak_per_s"]) == (60.0, leak)
    evidence = certificate.evidence
    assert (evidence["leak"], evidence["samples"] * law.dt, evidence["moment"]) == (leak, 60.0, list(MOMENT))
    assert evidence["vehicle"]["inertia_B"] == list(VEHICLE.inertia_B)
    assert [evidence["law"][key] for key in "ACG"] == [getattr(law, key).tolist() for key in "ACG"]
    assert [evidence["law"][key] for key in "BD"] == [getattr(law, key)[:, :3].tolist() for key in "BD"]


def leaves(value, path=()):
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, (*path, key))
    else:
        yield path


def test_one_changed_bit_anywhere_is_refused(certificate):
    document = json.loads(json.dumps(certificate.to_dict()))
    paths = list(leaves(document))
    assert len(paths) > 200
    for path in paths:
        place = document
        for key in path[:-1]:
            place = place[key]
        old = place[path[-1]]
        place[path[-1]] = float(np.nextafter(old, np.inf)) if isinstance(old, float) else f"{old}x"
        assert not check(json.dumps(document)).accepted, path
        place[path[-1]] = old
    assert check(json.dumps(document)).accepted


def test_a_command_that_may_saturate_is_not_proven():
    law = load_law("hinf-d2")
    certificate = certify_boundedness(replace(law, limits=np.full(3, 1e-6)), VEHICLE, moment=MOMENT, horizon=0.5)
    assert not certificate.proven
