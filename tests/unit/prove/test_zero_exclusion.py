"""Stability over boxes of inertia and lag: closed forms, other models of the loop, members beyond the limit."""

import math
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.law.form import Law, load_law
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, lft, sensitivity, series
from gustproof.studies.rate import axis_loop as axis_loop_module
from gustproof.studies.rate import zero_exclusion
from gustproof.studies.rate.axis_loop import AxisLoop, axis_loop
from gustproof.studies.rate.zero_exclusion import ParameterBox, is_proven

VEHICLE = load_vehicle("paper")
SCENARIO = load_scenario("paper-turbulence")
OMEGA = np.geomspace(0.1, 700.0, 20)


def law_of(A, B, C, D) -> Law:
    """Three equal axes, one after the other: x+ = A x + B y, u = C x + D y."""
    n = len(B)
    big_B, big_D = np.zeros((3 * n, 6)), np.zeros((3, 6))
    big_B[:, :3], big_D[:, :3] = np.kron(np.eye(3), np.reshape(B, (n, 1))), D * np.eye(3)
    return replace(
        load_law("hinf-d1"),
        A=np.kron(np.eye(3), np.reshape(A, (n, n))),
        B=big_B,
        C=np.kron(np.eye(3), np.reshape(C, (1, n))),
        D=big_D,
        G=np.zeros((3 * n, 3)),
        H=np.zeros((3 * n, 3)),
    )


def gain_loop(k: float, delay: int = 0) -> AxisLoop:
    """u = -k rate, undamped; the law has a state that nothing reaches."""
    scenario, vehicle = replace(SCENARIO, delay_samples=delay), replace(VEHICLE, rate_damping=0.0)
    return axis_loop(law_of([[0.5]], [0.0], [0.0], -k), vehicle, scenario, 0)


def box_of(loop: AxisLoop, inertia: float, lag: float) -> ParameterBox:
    return ParameterBox(
        inertia=((1.0 - inertia) * loop.inertia, (1.0 + inertia) * loop.inertia),
        lag=((1.0 - lag) * loop.actuator_lag, (1.0 + lag) * loop.actuator_lag),
    )


def one_axis(inertia_share: float, lag_share: float, damping: float, delay: int) -> Lti:
    """Roll from command to gyro by the matrix exponential of the whole linear vehicle."""
    I_x, I_y, I_z = VEHICLE.inertia_B
    vehicle = replace(
        VEHICLE,
        inertia_B=(inertia_share * I_x, I_y, I_z),
        actuator_lag=lag_share * VEHICLE.actuator_lag,
        rate_damping=damping,
    )
    return hover_plant(vehicle, replace(SCENARIO, delay_samples=delay)).subsystem(slice(0, 1), slice(0, 1))


@pytest.mark.parametrize("damping", [0.02, 0.0, 1.0 / VEHICLE.actuator_lag])
@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("name", ["flagship", "hinf-scheduled"])
def test_axis_loop_is_the_law_on_the_linear_vehicle(name, delay, damping):
    law, vehicle = load_law(name), replace(VEHICLE, rate_damping=damping)
    loop = axis_loop(law, vehicle, replace(SCENARIO, delay_samples=delay), 0)
    members = ((1.0, 1.0), (0.4, 0.3), (0.8, 1.3), (1.9, 0.05))
    inertia, lag = (
        np.array(values) * nominal
        for values, nominal in zip(zip(*members, strict=True), (loop.inertia, loop.actuator_lag), strict=True)
    )
    radii, S = loop.spectral_radius(inertia, lag), loop.sensitivity(OMEGA, inertia, lag)
    controller = loop_law(law).subsystem(slice(0, 1), slice(0, 1))
    for k, (heavier, slower) in enumerate(members):
        plant = one_axis(heavier, slower, damping, delay)
        L = series(plant, controller)
        np.testing.assert_allclose(S[k], 1.0 / (1.0 - L.response(OMEGA)[:, 0, 0]), rtol=1e-8)
        # the plant has the poles of the other axes too, which the law of this one leaves alone
        poles = np.abs(lft(plant, controller).poles())
        assert np.min(np.abs(poles - radii[k])) < 1e-9
        assert loop.is_stable_at(inertia[k], lag[k]) == (radii[k] < 1.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_axis_loop_has_the_damping_of_its_axis(axis):
    law, vehicle = load_law("flagship"), load_vehicle("iris")
    loop, own = axis_loop(law, vehicle, SCENARIO, axis), slice(axis, axis + 1)
    plant, controller = hover_plant(vehicle, SCENARIO).subsystem(own, own), loop_law(law).subsystem(own, own)
    S = loop.sensitivity(OMEGA, np.array([loop.inertia]), np.array([loop.actuator_lag]))[0]
    np.testing.assert_allclose(S, 1.0 / (1.0 - series(plant, controller).response(OMEGA)[:, 0, 0]), rtol=1e-8)


def product_of(*factors) -> tuple[Fraction, ...]:
    whole = np.array([Fraction(1)], dtype=object)
    for factor in factors:
        whole = np.convolve(whole, np.array([Fraction(x) for x in factor], dtype=object))
    return tuple(whole)


STABLE = ((2, 1), (1, 1, 1), (3, 0.125, 1), (0.5, 1))


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("other", [(0, 1), (-1, 1), (1, 0, 1), (-1, 0, 1), (1, -0.25, 1), (4, 0, 5, 0, 1)])
def test_routh_tells_stable_polynomials_from_those_with_a_root_on_or_beyond_the_axis(count, other):
    assert axis_loop_module._is_hurwitz(product_of(*STABLE[:count]))
    assert not axis_loop_module._is_hurwitz(product_of(*STABLE[:count], other))
    assert not axis_loop_module._is_hurwitz(product_of(other))
    assert not axis_loop_module._is_hurwitz((*product_of(*STABLE[:count]), Fraction(0)))  # a pole at z = -1


def limit_of_gain(loop: AxisLoop, lag: float) -> float:
    """Largest gain over inertia: (z - 1)(z - a) + k v ((b - c) z + c - b a) has its constant term below 1 (Jury)."""
    dt, a = loop.dt, math.exp(-loop.dt / lag)
    c = lag * (1.0 - a)
    return (1.0 - a) / (c - dt * a)


@pytest.mark.slow
@pytest.mark.parametrize("batch", [8192, 100])
def test_rate_feedback_is_proved_up_to_the_closed_form_limit_and_not_beyond(batch, monkeypatch):
    monkeypatch.setattr(zero_exclusion, "_BATCH", batch)
    unit = gain_loop(1.0)
    lag = 1.3 * unit.actuator_lag  # the slowest actuator limits the gain
    for beyond, expected in ((0.9995, True), (1.0005, False)):
        k = beyond * limit_of_gain(unit, lag) * 0.8 * unit.inertia  # and so does the least inertia
        loop = gain_loop(k)
        assert is_proven(loop, box_of(loop, 0.2, 0.3)) is expected
        assert loop.is_stable_at(0.8 * loop.inertia, lag) is expected


def test_a_family_without_a_stable_member_is_not_proved_though_no_pole_crosses_the_circle():
    unit = gain_loop(1.0)
    loop = gain_loop(3.0 * limit_of_gain(unit, unit.actuator_lag) * unit.inertia)
    assert not is_proven(loop, box_of(loop, 0.1, 0.1))


def test_peak_is_proved_down_to_the_norm_of_the_sensitivity():
    loop = axis_loop(load_law("flagship"), VEHICLE, SCENARIO, 0)
    plant = one_axis(1.0, 1.0, VEHICLE.rate_damping_B[0], 1)
    L = series(plant, loop.controller)
    peak = hinf_norm(sensitivity(Lti(A=L.A, B=L.B, C=-L.C, D=-L.D, dt=L.dt))).gain
    point = box_of(loop, 0.0, 0.0)
    assert is_proven(loop, point, peak=1.0005 * peak)
    assert not is_proven(loop, point, peak=0.9995 * peak)


def test_a_narrow_resonance_is_not_missed():
    # a law with poles at radius 1 - 1e-6: |S| exceeds 1.5 on a band of 1e-5 of its frequency only
    z = (1.0 - 1e-6) * np.exp(0.7j)
    law = law_of([[2.0 * z.real, -(abs(z) ** 2)], [1.0, 0.0]], [1.0, 0.0], [3e-4, -1e-4], -1.0)
    loop = axis_loop(law, VEHICLE, SCENARIO, 0)
    coarse = np.geomspace(0.01, 0.999 * math.pi / loop.dt, 2000)
    here = (np.array([loop.inertia]), np.array([loop.actuator_lag]))
    assert loop.spectral_radius(*here) < 1.0
    pole = 0.7 / loop.dt
    fine = pole + np.linspace(-0.05, 0.05, 200_001)
    largest = np.max(np.abs(loop.sensitivity(fine, *here)))
    assert np.max(np.abs(loop.sensitivity(coarse, *here))) < 0.9 * largest
    assert not is_proven(loop, box_of(loop, 0.0, 0.0), peak=0.99 * largest)
    assert is_proven(loop, box_of(loop, 0.0, 0.0), peak=1.01 * largest)


def test_a_family_stable_at_its_ends_and_unstable_between_is_not_proved():
    # s^3 + v s^2 + v s + 4 v - 3.9 is stable where v^2 > 4 v - 3.9 (Routh): at 1 and 3.5, not at 2
    tau, J = 0.05, 1.0
    loop = replace(gain_loop(1.0), inertia=J, actuator_lag=tau)
    beta, c = (Fraction(float(term)) for term in loop.lag_terms(tau))
    b = Fraction(loop.held_gain)
    fixed = np.array([-Fraction(39, 10), 0, 0, 1]), np.array([-4, -1, -1, 0])
    lag, held = np.array([beta, 2 - beta]), np.array([b * beta, b * (2 - beta) - 2 * c])
    loop = replace(loop, denominator=tuple(np.convolve(fixed[0], held)), numerator=tuple(np.convolve(fixed[1], lag)))
    low, high = (4.0 - math.sqrt(0.4)) / 2.0, (4.0 + math.sqrt(0.4)) / 2.0
    assert [loop.is_stable_at(1.0 / v, tau) for v in (1.0, 0.999 * low, 2.0, 1.001 * high, 3.5)] == [1, 1, 0, 1, 1]

    def proven(v_low: float, v_high: float) -> bool:
        return is_proven(loop, ParameterBox(inertia=(1.0 / v_high, 1.0 / v_low), lag=(tau, tau)))

    assert proven(1.0, 0.999 * low)
    assert proven(1.001 * high, 3.5)
    assert not proven(1.0, 3.5)
    assert not proven(1.0, 1.0001 * low)
    assert not proven(0.97, 1.0)  # a root at 0


def first_unstable_factor(loop: AxisLoop) -> float:
    """Least multiple of inertia 20 % and lag 30 % with an unstable member on a fine grid of all members."""
    ends = np.linspace(-1.0, 1.0, 17)
    edge = np.concatenate([[(x, e), (e, x)] for x in ends for e in (-1.0, 1.0)])
    for factor in np.arange(0.0, 3.3, 0.01):
        members = (
            (1.0 + 0.2 * factor * edge[:, 0]) * loop.inertia,
            (1.0 + 0.3 * factor * edge[:, 1]) * loop.actuator_lag,
        )
        if np.max(loop.spectral_radius(*members)) >= 1.0:
            return float(factor)
    return math.inf


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_random_laws_are_proved_up_to_their_first_unstable_member(seed):
    rng = np.random.default_rng(seed)
    found = math.inf
    while not 0.05 < found < 3.0:  # poles on either side: some loops break up near half the sample rate
        A, C, D = rng.uniform(-0.97, 0.97, (2, 2)) * [[1.0, 0.3], [0.0, 1.0]], rng.normal(size=2), rng.normal()
        law = law_of(A, rng.normal(size=2), 12.0 * C, 12.0 * D)
        loop = axis_loop(law, VEHICLE, replace(SCENARIO, delay_samples=seed % 3), seed % 3)
        if loop.is_stable_at(loop.inertia, loop.actuator_lag):
            found = first_unstable_factor(loop)
    assert is_proven(loop, box_of(loop, 0.2 * (found - 0.015), 0.3 * (found - 0.015)))
    assert not is_proven(loop, box_of(loop, 0.2 * found, 0.3 * found))


def test_discs_hold_the_polynomial_over_the_whole_cell():
    loop = axis_loop(load_law("indi"), VEHICLE, SCENARIO, 1)
    rng = np.random.default_rng(2)
    for p in (loop.denominator, loop.numerator):
        coefficients = np.array(p, dtype=np.float64)
        t, h = rng.uniform(0.0, 1.0, 50), rng.uniform(0.0, 0.1, 50)
        (disc,) = zero_exclusion._discs(coefficients[None], t, h)
        for share in np.linspace(-1.0, 1.0, 21):
            values = np.polyval(coefficients[::-1], 1j * (t + share * h))
            assert np.all(np.abs(values - disc.centre) <= disc.by_frequency)
        # and are not much larger than the polynomial's change
        ends = np.abs(np.polyval(coefficients[::-1], 1j * (t + h)) - disc.centre)
        assert np.median(disc.by_frequency / ends) < 1.5


class RisingLoop(AxisLoop):
    """A loop with both terms rising along the lag, so that their changes add up."""

    def lag_terms(self, lag):
        return 8.0 * lag, 0.1 * lag


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize(("width", "lag_width"), [(0.1, 0.0), (1e-3, 0.4), (0.05, 0.2)])
@pytest.mark.parametrize("kind", [AxisLoop, RisingLoop])
def test_cells_hold_the_polynomials_of_every_lag_and_frequency(kind, width, lag_width, reverse):
    base = axis_loop(load_law("pid-fair"), VEHICLE, SCENARIO, 1)
    loop = kind(**{name: getattr(base, name) for name in AxisLoop.__dataclass_fields__})
    rng, count = np.random.default_rng(3), 40
    low, lag_low = rng.uniform(0.0, 1.0 - width, count), rng.uniform(0.005, 0.03, count)
    cells = zero_exclusion._Cells(low, low + width, lag_low, lag_low + lag_width * lag_low)
    discs, b = zero_exclusion._enclose(loop, cells, reverse), loop.held_gain
    for at, lag_at in [(x, y) for x in np.linspace(0.0, 1.0, 7) for y in np.linspace(0.0, 1.0, 7)]:
        s, (beta, c) = 1j * (low + at * width), loop.lag_terms(lag_low * (1.0 + lag_at * lag_width))
        lines = (beta, 2.0 - beta), (b * beta, b * (2.0 - beta) - 2.0 * c)
        for disc, p, line in zip(discs, (loop.denominator, loop.numerator), lines, strict=True):
            first, second = (np.outer(np.array(p, dtype=np.float64), part) for part in line)
            whole = np.vstack([first, np.zeros(count)]) + np.vstack([np.zeros(count), second])
            values = polyval(s, whole[::-1] if reverse else whole, tensor=False)
            assert np.all(np.abs(values - disc.centre) <= disc.by_frequency + disc.by_lag)


def test_a_disc_of_a_line_holds_every_change_of_its_coefficients():
    p, off, size = np.array([1.0, 0.5]), np.array([0.2, 0.3]), np.array([2.0, 2.0])
    t, h, line = np.array([0.7]), np.array([0.1]), np.array([p, off, size])[:, :, None]
    disc = zero_exclusion._disc_of_line(line, t, h)
    signs = product((-1.0, 1.0), repeat=3)
    members = [p[0] + x * off[0] + 1j * (0.7 + z * 0.1) * (p[1] + y * off[1]) for x, y, z in signs]
    corners = [abs(member - disc.centre[0]) for member in members]
    assert max(corners) <= disc.by_frequency[0] + disc.by_lag[0]
    assert disc.by_lag[0] == pytest.approx(0.2 + 0.8 * 0.3)
    assert disc.by_frequency[0] == pytest.approx(0.1 * 0.5, rel=1e-9)


@pytest.mark.parametrize("radius", range(4))
def test_every_radius_counts_in_full_against_the_distance(radius, monkeypatch):
    # v in [1, 2]: the segment from 5 - v (1 + j) is nearest to 0 at v = 2, where |3 - 2j|^2 = 13; half of |f0| is 2.5
    loop = gain_loop(1.0)
    inertia, clearance = (0.5, 1.0), 0.5
    distance = math.sqrt(13.0) - clearance * 5.0
    weight = (1.0 + clearance, 1.0 + clearance, 2.0, 2.0)[radius]
    for share, expected in ((0.999, True), (1.001, False)):
        radii = np.zeros(4)
        radii[radius] = share * distance / weight
        f0 = zero_exclusion._Disc(np.array([5.0 + 0.0j]), radii[0:1], radii[1:2])
        f1 = zero_exclusion._Disc(np.array([1.0 + 1.0j]), radii[2:3], radii[3:4])
        monkeypatch.setattr(zero_exclusion, "_enclose", lambda *_, discs=(f0, f1): discs)
        proven, by_frequency = zero_exclusion._examine(loop, inertia, clearance, None, False)
        assert proven.tolist() == [expected]
        assert by_frequency.tolist() == [radius in (0, 2)]


def test_rounding_is_a_small_part_of_what_widens_the_discs():
    loop = axis_loop(load_law("indi"), VEHICLE, SCENARIO, 1)
    for p in (loop.denominator, loop.numerator):
        for t in (1e-4, 0.011, 0.3, 0.97):
            powers = [Fraction(t) ** k for k in range(len(p))]
            terms = [coefficient * power for coefficient, power in zip(p, powers, strict=True)]
            exact = complex(sum(terms[0::4]) - sum(terms[2::4]), sum(terms[1::4]) - sum(terms[3::4]))
            (disc,) = zero_exclusion._discs(np.array([p], dtype=np.float64), np.array([t]), np.zeros(1))
            assert abs(disc.centre[0] - exact) < 0.01 * disc.by_frequency[0]


@pytest.mark.parametrize("damping", [0.0, 0.02, 20.0])
def test_lag_terms_are_accurate_and_monotonic(damping):
    loop = axis_loop(load_law("pid-fair"), replace(VEHICLE, rate_damping=damping), SCENARIO, 0)
    lags = np.array([5e-4, 0.015, 0.0499999, 0.05, 0.0500001, 0.0999])
    dt, d = Decimal(loop.dt), Decimal(damping)
    for lag, beta, c in zip(lags, *loop.lag_terms(lags), strict=True):
        decay, speed = (-dt / Decimal(lag)).exp(), 1 / Decimal(lag)
        same = abs(speed - d) < Decimal("1e-12")
        exact = dt * decay if same else ((-d * dt).exp() - decay) / (speed - d)
        assert beta == pytest.approx(float(1 - decay), rel=1e-13)
        assert c == pytest.approx(float(exact), rel=1e-13)
    assert np.all(np.diff(loop.lag_terms(lags), axis=1) * [[-1.0], [1.0]] > 0.0)


def test_a_law_of_another_sample_time_is_refused():
    with pytest.raises(ValueError, match=r"steps every 0\.002 s"):
        axis_loop(replace(load_law("flagship"), dt=0.002), VEHICLE, SCENARIO, 0)


def test_a_law_without_a_loop_of_one_gyro_is_refused():
    with pytest.raises(ValueError, match="law 'aided' couples its axes, uses the accelerometer or commands no torque"):
        axis_loop(load_law("aided"), VEHICLE, SCENARIO, 0)


def test_a_law_of_too_many_states_or_digits_is_refused_before_any_work():
    n = 41
    with pytest.raises(ValueError, match="41 states in one axis, at most 40"):
        axis_loop(law_of(0.5 * np.eye(n), np.ones(n), np.ones(n), 0.0), VEHICLE, SCENARIO, 0)
    with pytest.raises(ValueError, match="too many orders of magnitude"):
        axis_loop(law_of(np.full((8, 8), 1e-300), np.ones(8), np.ones(8), 0.0), VEHICLE, SCENARIO, 0)
