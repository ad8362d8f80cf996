"""A proved chance: its air is the vehicle's, its deviations those of the linear model, and no forgery is accepted."""

import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.special import erfc

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle, vehicle_path
from firmware_model.config.waveforms import Dryden
from firmware_model.physics.dryden import dryden_filters, dryden_spectrum
from gustproof.certify.air_box import certify_chance
from gustproof.certify.boundedness import FlightCertificate
from gustproof.certify.check.dryden_air import read_air
from gustproof.certify.check.evidence import check_certificate, seal
from gustproof.certify.check.gaussian_loop import least_angle, loop_deviations
from gustproof.certify.check.system import Refusal, read_system, sha256
from gustproof.law.form import law_path, load_law
from gustproof.performance.chance import attitude_box, sample_deviations
from gustproof.performance.covariance import axis_models

WIND = '[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 15.0\n'
AIR = f'description = "a breath"\nduration_s = 0.4\n\n{WIND}'
LAW = law_path("flagship").read_text(encoding="utf-8")
VEHICLE = vehicle_path("paper").read_text(encoding="utf-8")
SYSTEM = read_system(LAW, VEHICLE)


@pytest.fixture(scope="module")
def breath(tmp_path_factory: pytest.TempPathFactory) -> FlightCertificate:
    path = tmp_path_factory.mktemp("air") / "breath.toml"
    path.write_text(AIR, encoding="utf-8")
    return certify_chance("flagship", "paper", path, risk=1e-3)


def check(evidence: dict[str, Any], *, law: str = LAW, vehicle: str = VEHICLE, scenario: str | None = AIR) -> Any:
    document = {"format": "gustproof-certificate-1", "evidence": evidence}
    text = json.dumps({**document, "seal": seal(document)})
    return check_certificate(text, law=law, vehicle=vehicle, scenario=scenario)


@pytest.mark.plain
@pytest.mark.parametrize("name", ["paper", "iris"])
def test_the_air_is_the_one_that_the_vehicle_flies_in(name: str) -> None:
    vehicle, text = load_vehicle(name), vehicle_path(name).read_text(encoding="utf-8")
    law = law_path("flagship").read_text(encoding="utf-8")
    scenario = AIR.replace("wind_speed_20ft_mps = 15.0", 'intensity = "moderate"\nairspeed_mps = 20.0')
    air = read_air(f"gust_scale = 0.7\naltitude_m = 40.0\n{scenario}", text, read_system(law, text))
    dryden = Dryden(kind="dryden", intensity="moderate", airspeed_mps=20.0)
    filters, factor = dryden_filters(dryden_spectrum(dryden, 40.0, vehicle.span), vehicle.span, 0.004)
    P = factor @ factor.T
    gain, drag = 0.7 * vehicle.gust_gain, vehicle.rate_damping_B
    v, w = ([f.c1, f.c2] for f in (filters.v, filters.w))
    deviation = [
        # moment [N*m] and acceleration by the angular gust [rad/s^2]
        (gain * math.sqrt(v @ P[1:3, 1:3] @ v), 0.7 * drag[0] * factor[7, 7]),
        (gain * factor[0, 0], 0.7 * drag[1] * _turn(filters.w, P[4:7, 4:7])),
        (gain * vehicle.gust_yaw_ratio * math.sqrt(w @ P[4:6, 4:6] @ w), 0.7 * drag[2] * _turn(filters.v, P[1:4, 1:4])),
    ]
    for axis, expected in zip(air.axes, deviation, strict=True):
        A, stationary = (np.array(rows, dtype=float) for rows in (axis.A, axis.P))
        for row, value in zip((axis.moment, axis.turn), expected, strict=True):
            c = np.array(row, dtype=float)
            assert math.sqrt(c @ stationary @ c) == pytest.approx(value, rel=1e-9)
        assert np.min(np.linalg.eigvalsh(stationary - A @ stationary @ A.T)) > -1e-15
    poles = [np.diag(np.array(axis.A, dtype=float)) for axis in air.axes]
    assert poles[0] == pytest.approx([filters.v.a11, filters.v.a22, filters.p_a], rel=1e-12)
    assert poles[1] == pytest.approx([filters.u_a, filters.w.a11, filters.w.a22, filters.w.a33], rel=1e-12)
    assert poles[2] == pytest.approx([*poles[1][1:3], *poles[0][:2], filters.v.a33], rel=1e-12)
    assert np.array(air.axes[1].A, dtype=float)[2, 1] == pytest.approx(filters.w.a21, rel=1e-12)
    assert float(air.noise) == pytest.approx(axis_models(vehicle, load_scenario("paper-turbulence"))[0].noise, rel=1e-9)


def _turn(f: Any, P: np.ndarray) -> float:
    row = f.slope * np.array([f.c1, f.c2, -1.0])
    return math.sqrt(row @ P @ row)


@pytest.mark.plain
def test_deviations_are_those_of_the_linear_model_and_not_below() -> None:
    # without damping no angular gust acts, which the linear model leaves out
    still = VEHICLE.replace("rate_damping = 0.02", "rate_damping = 0.0")
    system = read_system(LAW, still)
    found = loop_deviations(system, read_air(AIR, still, system))
    scenario = replace(load_scenario("paper-turbulence"), duration_s=0.4)
    sigmas = sample_deviations(load_law("flagship"), replace(load_vehicle("paper"), rate_damping=0.0), scenario)
    for axis in range(3):
        angle, rate, torque, command = np.max(sigmas[:, axis], axis=0)
        own = [float(value) for value in found.signals[axis]]
        assert own[:3] == pytest.approx([rate, torque, command], rel=1e-7)
        assert all(a >= b for a, b in zip(own[:3], (rate, torque, command), strict=True))
        # the sum of the gyro's trapezoid leaves the angle by less than a thousandth of its peak
        assert float(max(found.angle[axis])) == pytest.approx(angle, rel=3e-3)


@pytest.mark.plain
@pytest.mark.parametrize("risk", [1e-9, 1e-4, 0.2])
def test_an_angle_is_beyond_its_bound_with_the_risk_at_most(risk: float) -> None:
    sigmas = [0.0, 0.001, 0.003, 0.002]
    bound = float(least_angle([Fraction(value) for value in sigmas], 50, Fraction(risk)))
    exact = sum(50 * erfc(bound / (math.sqrt(2.0) * value)) for value in sigmas if value)
    nearer = sum(50 * erfc(0.96 * bound / (math.sqrt(2.0) * value)) for value in sigmas if value)
    assert exact <= risk < nearer


def test_a_breath_of_air_is_proved_and_close_to_the_prediction(breath: FlightCertificate) -> None:
    assert breath.proven
    scenario = replace(load_scenario("paper-turbulence"), duration_s=0.4)
    predicted = attitude_box(load_law("flagship"), load_vehicle("paper"), scenario, 1e-3).attitude_deg
    assert breath.truth_deg is not None
    for proved, other in zip(breath.truth_deg, predicted, strict=True):
        assert proved is not None
        assert other < proved < 1.4 * other + 0.03
    verdict = check(breath.evidence)
    assert (verdict.accepted, verdict.reason) == (True, breath.statement)
    assert "for 0.4 s, but for a risk of 0.001" in verdict.reason


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"risk": 1e-5}, "does not close"),
        ({"risk": 0.0}, "must be a probability"),
        ({"risk": 1.0}, "must be a probability"),
        ({"risk": "1e-3"}, "finite number"),
        ({"samples": 8}, "unstable or too slow"),
        ({"samples": True}, "whole number"),
        ({"scenario_sha256": sha256("calm")}, "the scenario file is not the one"),
        ({"law_sha256": sha256("{}")}, "the law file is not the one"),
        ({"box": []}, "three axes"),
        ({"part": 1.0}, "other entries: part"),
    ],
)
def test_a_forged_chance_is_refused(breath: FlightCertificate, change: dict[str, Any], reason: str) -> None:
    verdict = check({**breath.evidence, **change})
    assert not verdict.accepted
    assert reason in verdict.reason


def test_every_bound_of_the_box_is_needed(breath: FlightCertificate) -> None:
    box = breath.evidence["box"]
    for axis, k in ((0, 0), (0, 1), (1, 2), (1, 3), (2, 4), (0, -1), (1, -2), (2, -3), (2, -4)):
        forged = [list(row) for row in box]
        forged[axis][k] *= 0.999
        verdict = check({**breath.evidence, "box": forged})
        assert not verdict.accepted
        assert f"axis {axis}: the bound" in verdict.reason


def test_a_check_needs_the_scenario_that_was_proved(breath: FlightCertificate) -> None:
    assert "give all three" in check(breath.evidence, scenario=None).reason
    assert "the scenario file is not" in check(breath.evidence, scenario=AIR.replace("15.0", "14.9")).reason


@pytest.mark.plain
@pytest.mark.parametrize(
    ("scenario", "reason"),
    [
        ("duration_s = 1.0", "has no turbulence"),
        (AIR + WIND, "or other winds"),
        (f"initial_attitude_deg = [0.0, 0.0, 1.0]\n{AIR}", "initial_attitude_deg"),
        (f"delay_samples = 2\n{AIR}", "another delay"),
        (f"control_rate_hz = 500\n{AIR}", "another sample time"),
        (f'translation = "free"\n{AIR}', "a free flight"),
        (f"altitude_m = 400.0\n{AIR}", "altitude_m is 400.0"),
        (f"gust_scale = -1.0\n{AIR}", "gust_scale is -1.0"),
        (AIR.replace("0.4", "1001.0"), "at most"),
        (f"{AIR}seed = 1", "does not know"),
        (f'{AIR}intensity = "light"', "either a speed or an intensity"),
        (f"{AIR}airspeed_mps = 0.5", "airspeed_mps is 0.5"),
    ],
)
def test_a_flight_of_more_than_turbulence_is_refused(scenario: str, reason: str) -> None:
    with pytest.raises(Refusal, match=reason):
        read_air(scenario, VEHICLE, SYSTEM)


@pytest.mark.plain
@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("[gyro]", '[gyro]\nnoise_model = "state-dependent"', "not constant"),
        ("nominal = 0.0, low = -2e-5", "nominal = 1e-6, low = -2e-5", "has a bias"),
        ("gust_gain = 0.0763", "gust_gain = -0.0763", "gust_gain is -0.0763"),
        ("span = 1.0 ", "span = 0.001 ", "too long for the air"),
    ],
)
def test_a_vehicle_whose_air_is_unknown_is_refused(old: str, new: str, reason: str) -> None:
    with pytest.raises(Refusal, match=reason):
        read_air(AIR, VEHICLE.replace(old, new), SYSTEM)
