"""A proved chance: its air is the vehicle's, its deviations those of the linear model, and no forgery is accepted."""

import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.special import erfc

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle, vehicle_path
from firmware_model.config.waveforms import Dryden
from firmware_model.physics.dryden import dryden_filters, dryden_spectrum
from gustproof.airframe.chance import attitude_box, sample_deviations
from gustproof.airframe.covariance import axis_models
from gustproof.checker import gaussian_box, gaussian_loop
from gustproof.checker.dryden_air import _exponential, read_air
from gustproof.checker.evidence import check_certificate, seal
from gustproof.checker.flight_box import LEAST_RISK
from gustproof.checker.gaussian_box import bound_flight, map_gaussian_box, read_scope
from gustproof.checker.gaussian_loop import least_angle, loop_deviations
from gustproof.checker.system import Refusal, read_system, sha256
from gustproof.law.form import law_path, load_law
from gustproof.prove.air_box import certify_chance
from gustproof.prove.boundedness import FlightCertificate

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


def check(evidence: dict[str, Any], *, vehicle: str | None = VEHICLE, scenario: str | None = AIR) -> Any:
    document = {"format": "gustproof-certificate-1", "evidence": evidence}
    text = json.dumps({**document, "seal": seal(document)})
    return check_certificate(text, law=LAW, vehicle=vehicle, scenario=scenario)


def test_a_share_of_the_gusts_is_not_stated_as_the_whole(breath: FlightCertificate) -> None:
    for scenario, told in (
        (AIR, "in Dryden turbulence of 15 m/s"),
        (f"gust_scale = 0.01\n{AIR}", "in 0.01 times the Dry"),
    ):
        verdict = check({**breath.evidence, "scenario_sha256": sha256(scenario)}, scenario=scenario)
        assert verdict.accepted
        assert told in verdict.reason


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
        (gain * factor[0, 0], 0.7 * drag[1] * _slope_deviation(filters.w, P[4:7, 4:7])),
        (
            gain * vehicle.gust_yaw_ratio * math.sqrt(w @ P[4:6, 4:6] @ w),
            0.7 * drag[2] * _slope_deviation(filters.v, P[1:4, 1:4]),
        ),
    ]
    for axis, expected in zip(air.axes, deviation, strict=True):
        A, stationary = (np.array(rows, dtype=float) for rows in (axis.A, axis.P))
        for row, value in zip((axis.moment, axis.turn), expected, strict=True):
            c = np.array(row, dtype=float)
            found = math.sqrt(c @ stationary @ c)
            assert found == pytest.approx(value, rel=1e-9)
            assert found >= (1.0 - 3e-13) * value
        assert np.min(np.linalg.eigvalsh(stationary - A @ stationary @ A.T)) > -1e-15
    poles = [np.diag(np.array(axis.A, dtype=float)) for axis in air.axes]
    assert poles[0] == pytest.approx([filters.v.a11, filters.v.a22, filters.p_a], rel=1e-12)
    assert poles[1] == pytest.approx([filters.u_a, filters.w.a11, filters.w.a22, filters.w.a33], rel=1e-12)
    assert poles[2] == pytest.approx([*poles[1][1:3], *poles[0][:2], filters.v.a33], rel=1e-12)
    assert np.array(air.axes[1].A, dtype=float)[2, 1] == pytest.approx(filters.w.a21, rel=1e-12)
    assert air.noise >= Fraction(10.0 ** (-float(vehicle.gyro.snr_db) / 20.0) * float(vehicle.gyro.reference_rate))
    assert float(air.noise) == pytest.approx(axis_models(vehicle, load_scenario("paper-turbulence"))[0].noise, rel=1e-9)


def _slope_deviation(f: Any, P: np.ndarray) -> float:
    row = f.slope * np.array([f.c1, f.c2, -1.0])
    return math.sqrt(row @ P @ row)


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


@pytest.mark.parametrize("intensity", [("light", 7.71666), ("moderate", 15.43332), ("severe", 23.14998)])
def test_named_intensities_and_what_a_scenario_leaves_out(intensity: tuple[str, float]) -> None:
    name, speed = intensity
    scenario = AIR.replace("wind_speed_20ft_mps = 15.0", f'intensity = "{name}"\nspecification = "MIL-HDBK-1797"')
    air = read_air(scenario, VEHICLE, SYSTEM)
    assert (air.wind, air.airspeed) == pytest.approx((speed, speed), rel=1e-12)
    assert (air.altitude, air.gust_scale, air.steps) == (10.0, 1.0, 101)  # .4 is a little more in doubles


def test_numbers_at_the_ends_of_their_ranges_are_taken() -> None:
    air = read_air("altitude_m = 304.8\n" + AIR.replace("15.0", "0.5").replace("0.4", "1000.0"), VEHICLE, SYSTEM)
    assert (air.airspeed, air.altitude, air.steps) == (1.0, 304.8, 250_000)
    F = ((Fraction(-500), Fraction(0)), (Fraction(50), Fraction(-1)))
    series = np.array(_exponential(F, Fraction(1, 250)), dtype=float)
    assert series == pytest.approx(expm(0.004 * np.array(F, dtype=float)))
    with pytest.raises(Refusal, match="too long"):
        _exponential(F, Fraction(1, 249))


ROWS = [23.891862810, 38.020838256, -79.038332627]
COARSE = [
    *(-127.4281584089, -116.0040783735, -198.5778795549),
    *(-41.84657514252, -42.12381246292, -44.29790360578, -3.081370815303),
]
MOMENTS = [1.9456127509, 1.9454583970, 0.30911126808]
TRUTH = [0.627428, 0.727913, 0.19658]
"""Of a breath, signals as logarithms weighted by place: at the least risk, with coarse roundings; moment, truth."""


def test_every_term_of_the_bounds_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures pinned: a term left out, or another factor, moves one of them."""
    asked = []
    monkeypatch.setattr(gaussian_box, "least_deviations", lambda *of: Fraction(asked.append(of) or 9))
    flight = bound_flight(SYSTEM, read_air(AIR, VEHICLE, SYSTEM), LEAST_RISK, 8192)
    signals = len(loop_deviations(SYSTEM, flight.air).signals[0]) + 2  # of acceleration and noise too
    assert asked == [(3 * signals * 240, LEAST_RISK / 32)]  # in each sample of whole stretches
    rows = [[float(value) for value in row] for row in flight.gaussian]
    logarithms = [sum(k * math.log(value) for k, value in enumerate(row, 1)) for row in rows]
    assert logarithms == pytest.approx(ROWS, rel=1e-8)
    assert [float(value) for value in flight.case.moment] == pytest.approx(MOMENTS, rel=1e-8)


def test_every_rounding_of_the_deviations_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures pinned, with roundings so coarse that each is felt."""
    monkeypatch.setattr(gaussian_loop, "_EPS", 2.0**-16)
    monkeypatch.setattr(gaussian_loop, "UP", 1.0 + 2.0**-12)
    found = loop_deviations.__wrapped__(SYSTEM, read_air(AIR, VEHICLE, SYSTEM))
    rows = [*found.signals, *(row[-3:] for row in found.angle), found.acceleration]
    logarithms = [sum(k * math.log(value) for k, value in enumerate(row, 1)) for row in rows]
    assert logarithms == pytest.approx(COARSE, rel=1e-11)


def test_air_moves_the_loop_by_moment_and_turn_together(monkeypatch: pytest.MonkeyPatch) -> None:
    air = read_air(AIR, VEHICLE, SYSTEM)
    n = gaussian_loop._stack(SYSTEM, air)[0].shape[1]
    monkeypatch.setattr(gaussian_loop, "_MOST_ORDER", n)
    rows, m = gaussian_loop._stack(SYSTEM, air)[3:]
    assert rows.shape == (3, m + 4, n)
    for i, axis in enumerate(air.axes):
        pairs = zip(axis.moment, axis.turn, strict=True)
        acceleration = [float(a / SYSTEM.inertia[i] + b) for a, b in pairs]
        assert rows[i, m + 2, m + 1 : m + 1 + len(acceleration)].tolist() == acceleration
    for lag in (SYSTEM.dt / 3, 5 / SYSTEM.dt):  # near the ends of what a sample's series takes
        gaussian_loop._stack(SYSTEM._replace(lag=lag), air)
    short = tuple(axis._replace(turn=axis.turn[:-1]) for axis in air.axes)
    with pytest.raises(ValueError, match="zip"):
        gaussian_loop._stack(SYSTEM, air._replace(axes=short))


def test_a_loop_that_diverges_or_is_too_large_and_a_risk_too_small_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    air, rows = read_air(AIR, VEHICLE, SYSTEM), [list(row) for row in SYSTEM.A]
    assert [loop_deviations(SYSTEM, air._replace(steps=steps)).samples for steps in (238, 239)] == [1, 2]
    rows[0][0] = Fraction(10**6)
    with pytest.raises(Refusal, match="diverges within the flight"):
        loop_deviations(SYSTEM._replace(A=tuple(map(tuple, rows))), air)
    with pytest.raises(Refusal, match="no bound of the air is known"):
        least_angle([Fraction(1)], 1, Fraction(1, 10**40))
    monkeypatch.setattr(gaussian_loop, "_MOST_ORDER", 3)
    with pytest.raises(Refusal, match=r"law '.*' has too many states for a bound of the rounding"):
        loop_deviations.__wrapped__(SYSTEM, air)


def test_risk_of_the_truth_is_shared_out_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = bound_flight(SYSTEM, read_air(AIR, VEHICLE, SYSTEM), Fraction(1, 1000), 8192)
    box = [[Fraction(7 + 5 * i + k, 4096) for k in range(len(row))] for i, row in enumerate(flight.gaussian)]
    rest, spent = map_gaussian_box(flight, box)[1], [Fraction(1, 32_000)]
    angle, truth = gaussian_box.least_angle, gaussian_box.truth_bound

    def bound_angle(sigmas: list[Fraction], samples: int, risk: Fraction) -> Fraction:
        assert samples == 1
        spent.append(risk)
        return angle(sigmas, samples, risk)

    def bound_truth(*of: Any) -> list[Fraction]:
        still, joint = of[-2:]
        assert (still.unseen, still.slope, still.steps) == ([0] * 3, [0] * 3, flight.air.steps + 1)
        spent.extend([still.risk, joint.risk])
        return truth(*of)

    monkeypatch.setattr(gaussian_box, "least_angle", bound_angle)
    monkeypatch.setattr(gaussian_box, "truth_bound", bound_truth)
    found, _ = gaussian_box._truth_deg(flight, Fraction(1, 1000), box, rest)
    assert sum(spent) == Fraction(1, 1000)
    assert found == pytest.approx(TRUTH, rel=1e-8)
    wide = [[100 * value for value in row] for row in box]
    found, why = gaussian_box._truth_deg(flight, Fraction(1, 1000), wide, rest)
    assert found is None
    assert why == "the true attitude has no bound below a radian over this horizon"


@pytest.mark.parametrize("law", ["aided", "hinf-rates"])
def test_a_law_whose_chance_has_no_proof_is_refused(law: str) -> None:
    with pytest.raises(Refusal, match="its chance has no proof"):
        read_scope(law_path(law).read_text(encoding="utf-8"), VEHICLE, AIR)


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
    assert verdict.assumes["delay_samples"] == 1


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
    for missing in ({"scenario": None}, {"vehicle": None}):
        assert "give all three" in check(breath.evidence, **missing).reason
    assert "the scenario file is not" in check(breath.evidence, scenario=AIR.replace("15.0", "14.9")).reason


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
        read_air(AIR, VEHICLE.replace(old, new, 1), SYSTEM)
