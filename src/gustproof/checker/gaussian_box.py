"""Theorem 6: in the Gaussian air of a scenario a flight stays in a box, but for a stated risk.

Part of the check: rational numbers, and doubles with bounds of their rounding.

**Two parts.** Every signal of Theorem 1 is the sum of a linear one, which air and gyro noise drive alone, and the rest.
The rest starts at 0, and the same loop is driven by all other inputs: gyroscopic products, kinematic excess, and every
rounding. The linear part is Gaussian, and `gaussian_loop` bounds its deviation at each sample from the start. A bound
of its samples, but for a risk, plus the rest that follows of a box must lie inside that box. As in Theorem 1 nothing
is then clipped, so the flight stays in the box for as long as the linear part keeps its bound.

**Truth.** By Theorem 2 the true rotation is that of the law's attitude, turned by the noise that its gyro summed up,
and by one-step errors. To first order the first two add up to a Gaussian number, the linear true angle, in which
feedback has its part. The rest of the noise's turn is products of angles, and a martingale whose increments are a few
hundredths of the noise. Both are bounded in the box; see `truth_drift`.

**Risk.** A share of 1/32 each is spent on the box, on mean square and size of the noise's sum, and on the martingale.
The rest is spent on the linear true angle, a third on each axis.
"""

from fractions import Fraction
from typing import Final, NamedTuple

from gustproof.checker.directed_rounding import float_down, float_up, list_up, print_down, print_up
from gustproof.checker.dryden_air import DrydenAir, read_air
from gustproof.checker.estimate_box import (
    DEMAND,
    Box,
    EstimateCase,
    axis_causes,
    bound_signals,
    check_box,
    estimate_excess,
    least_deviations,
    up,
)
from gustproof.checker.evidence_types import Assumptions, ChanceEvidence, Figures
from gustproof.checker.flight_box import (
    LEAST_RISK,
    Proof,
    bind_files,
    degrees_up,
    read_bounds,
)
from gustproof.checker.gaussian_loop import least_angle, loop_deviations
from gustproof.checker.kernel_norms import COMMAND, OMEGA, X0, AxisNorms, axis_norms
from gustproof.checker.system import (
    LoopSystem,
    Refusal,
    finite,
    is_strapdown,
    list_uncovered,
    read_system,
    sha256,
)
from gustproof.checker.truth_drift import Disturbance, Joint, truth_bound

KIND: Final = "chance"
KEYS = frozenset({"kind", "law_sha256", "vehicle_sha256", "scenario_sha256", "risk", "samples", "box"})
"""Every entry of the evidence; any other is refused."""
_SHARE = Fraction(1, 32)
"""[-] of the risk, for each of the three smaller bounds."""


class GaussianFlight(NamedTuple):
    """Loop, air and Gaussian bounds of a claim."""

    system: LoopSystem
    """Loop of law and vehicle."""
    air: DrydenAir
    """Air of the scenario."""
    norms: list[AxisNorms]
    """Norms of the three axes."""
    case: EstimateCase
    """Bounds of the air's moment, that of the angular gusts included, and of the gyro's noise."""
    gaussian: Box
    """Bounds of the linear part of each signal."""


def read_scope(law_text: str, vehicle_text: str, scenario_text: str) -> tuple[LoopSystem, DrydenAir]:
    """Return the loop and the air of the files.

    Raises
    ------
    Refusal
        If the law is none of torque from gyros, or the scenario has more than turbulence.
    """
    system = read_system(law_text, vehicle_text)
    if system.tilt is not None or system.rate_loop is not None:
        raise Refusal(f"law '{system.name}' reads the accelerometer or commands rates: its chance has no proof")
    return system, read_air(scenario_text, vehicle_text, system)


def bound_flight(system: LoopSystem, air: DrydenAir, risk: Fraction, samples: int) -> GaussianFlight:
    """Return norms, from `samples` simulated, and the Gaussian bounds of a flight.

    Raises
    ------
    Refusal
        If risk is no probability, or the loop unstable.
    """
    if not LEAST_RISK <= risk < 1:
        raise Refusal(f"risk is {float(risk)}, must be a probability, {float(LEAST_RISK):g} or more")
    norms = [axis_norms(system, axis, samples) for axis in range(3)]
    found = loop_deviations(system, air)
    # each signal, the air's acceleration and the gyro's noise, at each sample
    count = 3 * (len(found.signals[0]) + 2) * (found.samples * len(found.angle[0]))
    z, h = least_deviations(Fraction(count), _SHARE * risk), system.dt
    gaussian, moment = [], []
    for axis, row in enumerate(found.signals):
        *states, slew, gap = [z * value for value in row]
        kick = z * h * found.acceleration[axis]
        gaussian.append([*states, slew + kick, gap, states[COMMAND], states[OMEGA] + kick / 2])
        moment.append(z * found.acceleration[axis] * system.inertia[axis])
    return GaussianFlight(system, air, norms, EstimateCase(moment, air.noise, z), gaussian)


def map_gaussian_box(flight: GaussianFlight, box: Box) -> tuple[Box, Box]:
    """Return the bounds of all signals that follow if `box` bounds the nonlinear terms, and the nonlinear part of them.

    Raises
    ------
    ValueError
        If an angle of the box is above 1 rad.
    """
    system, e = flight.system, estimate_excess(flight.system, box)
    rest = []
    for axis, norms in enumerate(flight.norms):
        causes = axis_causes(system, flight.case, box, e, axis)
        # air and noise drive the linear part alone
        driven = causes._replace(moment=Fraction(0), noise=Fraction(0))
        rest.append(bound_signals(system, norms, axis, box[axis], driven))
    rows = zip(flight.gaussian, rest, strict=True)
    return [[Fraction(up(a + b)) for a, b in zip(x, y, strict=True)] for x, y in rows], rest


def prove_chance(evidence: ChanceEvidence, law_text: str, vehicle_text: str, scenario_text: str) -> Proof:
    """Return what the evidence proves of the law, the vehicle and the scenario in these texts.

    Raises
    ------
    Refusal
        If the texts are not those of the evidence, a number is out of its domain, or the box does not close.
    """
    if set(evidence) != KEYS:
        raise Refusal(f"the evidence has other entries: {', '.join(sorted(set(evidence) ^ KEYS))}")
    digests = evidence["law_sha256"], evidence["vehicle_sha256"], evidence["scenario_sha256"]
    texts = {"law": law_text, "vehicle": vehicle_text, "scenario": scenario_text}
    for (name, text), digest in zip(texts.items(), digests, strict=True):
        if digest != sha256(text):
            raise Refusal(f"the {name} file is not the one of this certificate: its SHA-256 is {sha256(text)}")
    samples = evidence["samples"]
    if isinstance(samples, bool) or not isinstance(samples, int):
        raise Refusal(f"samples are {samples!r}, must be a whole number")
    risk = finite("risk", evidence["risk"])
    flight = bound_flight(*read_scope(law_text, vehicle_text, scenario_text), risk, samples)
    if len(evidence["box"]) != 3:
        raise Refusal("the box does not bound three axes")
    sizes = [len(row) for row in flight.gaussian]
    box = [read_bounds(f"box of axis {i}", row, sizes[i]) for i, row in enumerate(evidence["box"])]
    follows, rest = map_gaussian_box(flight, box)
    check_box(flight.system, flight.case, box, follows)
    left = list_uncovered(
        vehicle_text, inertia=Fraction(0), lag=Fraction(0), noise=None, dt=flight.system.dt, gravity_aided=False
    )
    return bind_files(_describe(flight, risk, box, rest), texts, left)


def _describe(flight: GaussianFlight, risk: Fraction, box: Box, rest: Box) -> Proof:
    system, air = flight.system, flight.air
    truth, why = _truth_deg(flight, risk, box, rest)
    estimate, torque = [degrees_up(row[X0]) for row in box], [float_up(row[DEMAND]) for row in box]
    figures: Figures = {
        "risk": float_up(risk),
        "horizon_s": float_down(air.duration),
        "estimate_deg": estimate,
        "truth_deg": None if truth is None else [*truth],
        "torque_nm": torque,
    }
    scaled = "" if air.gust_scale == 1.0 else f"{print_down(air.gust_scale)} times the "
    words = (
        f"in {scaled}Dryden turbulence of {print_down(air.wind)} m/s at 20 ft and gyro noise of "
        f"{print_down(air.noise)} rad/s rms, law '{system.name}' keeps for {print_down(air.duration)} s, but for a "
        f"risk of {print_up(risk)}, its own attitude within {list_up(estimate)} deg and its torque below "
        f"{list_up(torque)} N*m, with nominal inertia and lag; "
    )
    words += (
        f"the true attitude stays within {list_up(each for each in truth if each is not None)} deg" if truth else why
    )
    return Proof(words, figures, _assumptions(flight, risk))


def _truth_deg(flight: GaussianFlight, risk: Fraction, box: Box, rest: Box) -> tuple[list[float] | None, str]:
    """Return the bounds of the true attitude [deg], or `None` and the reason."""
    system, steps = flight.system, flight.air.steps + 1
    if not is_strapdown(system):
        return None, "the true attitude has no proof: the law's own attitude is no pure integral of its gyro"
    found, share = loop_deviations(system, flight.air), _SHARE * risk
    try:
        each = (1 - 3 * _SHARE) * risk / 3
        angle = [least_angle(sigmas, found.samples, each) for sigmas in found.angle]
        still = Disturbance(unseen=[Fraction(0)] * 3, slope=[Fraction(0)] * 3, steps=steps, risk=share)
        joint = Joint(angle, [row[X0] for row in rest], share)
        truth = truth_bound(system, flight.case, box, still, joint)
    except Refusal as refusal:
        return None, str(refusal)
    return [degrees_up(value) for value in truth], ""


def _assumptions(flight: GaussianFlight, risk: Fraction) -> Assumptions:
    system, air = flight.system, flight.air
    return {
        "plant": "exact nonlinear rigid body on a stand with this damping per inertia, first-order actuators, "
        "gyro without bias, float32 on the wire",
        "air": "low-altitude Dryden filters in B, stationary, Gaussian, sampled with the law, with angular gusts",
        "wind_20ft_m_s": air.wind,
        "airspeed_m_s": air.airspeed,
        "altitude_m": air.altitude,
        "gust_scale": air.gust_scale,
        "law": system.name,
        "moment_between_samples": "held",
        "start": "at rest, level, all states of law and loops 0, in full turbulence",
        "sample_time_s": float(system.dt),
        "delay_samples": 1,
        "horizon_s": float_down(air.duration),
        "inertia_kg_m2": [float(value) for value in system.inertia],
        "actuator_lag_s": float(system.lag),
        "rate_damping_per_s": [float(value) for value in system.damping],
        "noise_rad_s": float_down(air.noise),
        "risk": float_up(risk),
    }
