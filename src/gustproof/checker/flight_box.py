"""Proof of a flight's box from the evidence of a certificate, the law file and the vehicle file.

Part of the check: rational arithmetic and rounded doubles only. The statement is made from the evidence; nothing that
a certificate says about itself is believed.
"""

import json
import math
from enum import Enum
from fractions import Fraction
from typing import Final, NamedTuple, cast

from gustproof.checker.attitude_offset import strapdown_box
from gustproof.checker.directed_rounding import (
    float_down,
    float_up,
    list_down,
    list_up,
    percent_down,
    print_down,
    print_up,
)
from gustproof.checker.estimate_box import DEMAND, Box, EstimateCase, check_box, least_deviations, map_box
from gustproof.checker.evidence_types import Assumptions, Figures, FlightEvidence
from gustproof.checker.gravity_aided_box import gravity_aided_truth, map_gravity_aided_box
from gustproof.checker.gravity_aided_norms import GravityAidedNorms, gravity_aided_norms
from gustproof.checker.kernel_norms import MOST_CELLS, X0, AxisNorms, axis_norms
from gustproof.checker.system import (
    LoopSystem,
    Refusal,
    finite,
    is_strapdown,
    list_uncovered,
    read_system,
    sha256,
)
from gustproof.checker.truth_drift import Disturbance, blind_angles, truth_bound

KIND: Final = "boundedness"
Norms = list[AxisNorms] | list[GravityAidedNorms]
"""Norms of the three axes, of a law of gyros or of one that reads tilt."""
KEYS = frozenset(
    {"kind", "law_sha256", "vehicle_sha256", "moment", "part", "moment_class", "slope", "horizon", "noise", "risk"}
    | {"inertia_spread", "lag_spread", "cells", "samples", "box"}
)
"""Every entry of the evidence; any other is refused."""
RISK_PERIOD = 600
"""[s] flight over which the risk of an unlimited horizon counts."""
LEAST_RISK = Fraction(1, 10**12)
"""[-] least risk for which the noise is bounded."""
_LONGEST_NAME = 100
"""Characters of a vehicle's name in the assumptions."""
LONGEST = 10**6
"""[s] longest finite horizon."""


class InterSampleMoment(Enum):
    """Knowledge of the moment between two samples; the box of the law's own attitude holds for all three.

    Examples
    --------
    >>> from gustproof import InterSampleMoment
    >>> InterSampleMoment("held")
    <InterSampleMoment.HELD: 'held'>
    """

    HELD = "held"
    """Constant from sample to sample, as simulated."""
    SLOPE = "slope"
    """Of a stated slope within a sample, with jumps at the samples."""
    ANY = "any"
    """Any function of time."""


class FlightClaim(NamedTuple):
    """Contents of the evidence, with every domain checked."""

    moment: list[Fraction]
    """(3,) [N*m] B, bound about each axis."""
    certified_fraction: Fraction
    """[-] certified part of the moment, at most 1."""
    moment_class: InterSampleMoment
    """Class of the moment."""
    slope: list[Fraction]
    """(3,) [N*m/s] B, largest slope within a sample; 0 for other classes."""
    horizon: Fraction | None
    """[s] of the flight; `None` without limit."""
    noise: Fraction
    """[rad/s] rms of a gyro sample."""
    risk: Fraction
    """[-] probability that the noise leaves its bounds; 0 without noise."""
    inertia_spread: Fraction
    """[-] share of each moment of inertia, below 1."""
    lag_spread: Fraction
    """[-] share of the lag, below 1."""
    cells: tuple[int, int]
    """Number of cells that cover the spreads of inertia and of lag."""
    samples: int
    """Number of simulated samples of the norms."""
    box: Box
    """Bounds of the signals."""


class Proof(NamedTuple):
    """Claim made from the evidence, in words and figures."""

    statement: str
    """The proved statement."""
    figures: Figures
    """Figures by name: part, estimate_deg, truth_deg, torque_nm, moment_class."""
    assumes: Assumptions
    """Assumptions by name."""


def prove_flight_box(evidence: FlightEvidence, law_text: str, vehicle_text: str) -> Proof:
    """Return what the evidence proves of the law and the vehicle in these texts.

    Raises
    ------
    Refusal
        If the texts are not those of the evidence, a number is out of its domain, or the box does not close.
    """
    for name, text in (("law", law_text), ("vehicle", vehicle_text)):
        if evidence.get(f"{name}_sha256") != sha256(text):
            raise Refusal(f"the {name} file is not the one of this certificate: its SHA-256 is {sha256(text)}")
    claim = read_claim(evidence)
    system = spread_system(read_system(law_text, vehicle_text), claim)
    if [len(row) for row in claim.box] != [count_signals(system)] * 3:
        raise Refusal("the box does not bound every signal of every axis")
    norms, case = flight_norms(system, claim.samples), make_case(system, claim)
    check_box(system, case, claim.box, map_flight(system, norms, case, claim.box))
    left = list_uncovered(
        vehicle_text,
        inertia=claim.inertia_spread,
        lag=claim.lag_spread,
        noise=claim.noise,
        dt=system.dt,
        gravity_aided=system.tilt is not None,
    )
    return bind_files(describe(system, claim), {"law": law_text, "vehicle": vehicle_text}, left)


def bind_files(proof: Proof, texts: dict[str, str], left: list[str]) -> Proof:
    """Return a proof that names its files by digest, the vehicle that the law is made for, and what is `left` out.

    A vehicle file need hold no name, so its digest stands for it in the statement.
    """
    made_for = json.loads(texts["law"])["provenance"]["vehicle"]
    if not isinstance(made_for, str) or not made_for.isprintable() or "\\" in made_for or len(made_for) > _LONGEST_NAME:
        raise Refusal(f"the law is made for vehicle {made_for!a}, must be a name")
    digests = {f"{name}_sha256": sha256(text) for name, text in texts.items()}
    files = {**digests, "law_made_for": made_for.encode("ascii", "backslashreplace").decode() or None}
    words = f"with the vehicle file {digests['vehicle_sha256'][:12]}, {proof.statement}"
    return proof._replace(statement=words, assumes={**files, **proof.assumes, "not_covered": left})


def flight_norms(system: LoopSystem, samples: int) -> Norms:
    """Return the norms of the three axes from a simulation of `samples`; raises `Refusal` as their functions do."""
    if system.tilt is None:
        return [axis_norms(system, axis, samples) for axis in range(3)]
    return [gravity_aided_norms(system, axis, samples) for axis in range(3)]


def count_signals(system: LoopSystem) -> int:
    """Return the number of bounds in a row of a box: of the states, and of the signals that follow from them."""
    states = X0 + len(system.A) // 3 + (0 if system.rate_loop is None else 2)
    return states + (4 if system.tilt is None else 8)


def map_flight(system: LoopSystem, norms: Norms, case: EstimateCase, box: Box) -> Box:
    """Return the bounds that follow from those of a box, by the theorem for the law; raises ValueError as they do."""
    gravity_aided = [item for item in norms if isinstance(item, GravityAidedNorms)]
    if gravity_aided:
        return map_gravity_aided_box(system, gravity_aided, case, box)
    return map_box(system, [item for item in norms if isinstance(item, AxisNorms)], case, box)


def read_claim(evidence: FlightEvidence) -> FlightClaim:
    """Return the contents of the evidence.

    Raises
    ------
    Refusal
        If an entry is missing, unknown or out of its domain.
    """
    if set(evidence) != KEYS:
        raise Refusal(f"the evidence has other entries: {', '.join(sorted(set(evidence) ^ KEYS))}")
    if evidence["kind"] != KIND:
        raise Refusal(f"unknown kind of evidence '{evidence['kind']}'")
    moment = read_bounds("moment", evidence["moment"])
    if max(moment) == 0:
        raise Refusal("moment is 0, must be positive about an axis")
    part, noise, risk = (finite(name, evidence[name]) for name in ("part", "noise", "risk"))
    if not 0 < part <= 1:
        raise Refusal(f"part is {float(part)}, must be above 0 and at most 1")
    if noise < 0:
        raise Refusal(f"noise is {float(noise)}, must not be negative")
    if not (LEAST_RISK <= risk < 1 if noise else risk == 0):
        raise Refusal(f"risk is {float(risk)}, must be a probability, {float(LEAST_RISK):g} or more; 0 without noise")
    moment_class = InterSampleMoment(evidence["moment_class"])
    slope = read_bounds("slope", evidence["slope"])
    if (moment_class is InterSampleMoment.SLOPE) != (max(slope) > 0):
        raise Refusal("a slope belongs to moments of class 'slope', and to no other")
    horizon = None if evidence["horizon"] is None else finite("horizon", evidence["horizon"])
    if horizon is not None and not 0 < horizon <= LONGEST:
        raise Refusal(f"horizon is {float(horizon)} s, must be positive, at most {LONGEST} s, or unlimited")
    spreads = [finite(name, evidence[name]) for name in ("inertia_spread", "lag_spread")]
    if not all(0 <= spread < 1 for spread in spreads):
        raise Refusal("a spread is a share of its value, 0 or more and below 1")
    samples, cells = evidence["samples"], evidence["cells"]
    if not isinstance(cells, list) or len(cells) != 2:
        raise Refusal(f"cells are {cells!r}, must be two whole numbers")
    for value in (samples, *cells):
        if isinstance(value, bool) or not isinstance(value, int):
            raise Refusal(f"samples and cells are {samples!r} and {cells!r}, must be whole numbers")
    if not all(1 <= value <= MOST_CELLS for value in cells):
        raise Refusal(f"cells are {cells}, must be 1 to {MOST_CELLS}")
    box = [read_bounds(f"box of axis {axis}", row, len(row)) for axis, row in enumerate(evidence["box"])]
    return FlightClaim(
        moment=moment,
        certified_fraction=part,
        moment_class=moment_class,
        slope=slope,
        horizon=horizon,
        noise=noise,
        risk=risk,
        inertia_spread=spreads[0],
        lag_spread=spreads[1],
        cells=(cells[0], cells[1]),
        samples=samples,
        box=box,
    )


def spread_system(system: LoopSystem, claim: FlightClaim) -> LoopSystem:
    """Return the loop with the spreads of a claim.

    Raises
    ------
    Refusal
        If the law reads tilt and the claim has noise or spreads.
    """
    if system.tilt is not None and (claim.noise or claim.inertia_spread or claim.lag_spread):
        raise Refusal(
            f"law '{system.name}' reads the accelerometer: its box is proved without noise and with nominal values"
        )
    return system._replace(inertia_spread=claim.inertia_spread, lag_spread=claim.lag_spread, cells=claim.cells)


def make_case(system: LoopSystem, claim: FlightClaim) -> EstimateCase:
    """Return the disturbances of a claim; the noise's bound takes half of the risk, the truth's drift the rest."""
    moment = [claim.certified_fraction * value for value in claim.moment]
    if claim.noise == 0:
        free = claim.moment_class is InterSampleMoment.ANY
        return EstimateCase(moment, Fraction(0), Fraction(0), free, tuple(claim.slope))
    period = RISK_PERIOD if claim.horizon is None else claim.horizon
    # signals and gyro of each axis at each sample
    count = 3 * (9 + Fraction(len(system.A), 3)) * (math.ceil(period / system.dt) + 2)
    return EstimateCase(moment, claim.noise, least_deviations(count, claim.risk / 2))


def describe(system: LoopSystem, claim: FlightClaim) -> Proof:
    """Return statement, figures and assumptions of a claim whose box closes."""
    estimate_deg = [degrees_up(row[X0]) for row in claim.box]
    truth_deg, why = _truth_deg(system, claim)
    figures: Figures = {
        "part": float_down(claim.certified_fraction),
        "estimate_deg": estimate_deg,
        "truth_deg": truth_deg,
        "moment_class": claim.moment_class.value,
        "torque_nm": [float_up(row[DEMAND]) for row in claim.box],
    }
    return Proof(_statement(system, claim, figures, why), figures, _assumptions(system, claim))


PROVEN = "proven"
"""Verdict on a claim that is proved as it was asked."""


def name_verdict(figures: Figures, assumes: Assumptions) -> str:
    """Return the verdict in words: what is proved of a part of the moment, or of the law's view alone, is not proven.

    Parameters
    ----------
    figures, assumes
        Figures and assumptions of an accepted certificate.
    """
    if (part := figures.get("part", 1.0)) < 1.0:
        asked = list_down(cast(list[float], assumes["moment_asked_N_m"]))
        return f"NOT proven for {asked} N m; proven for {percent_down(part, 3)} % of it"
    if "truth_deg" in figures and figures["truth_deg"] is None and assumes["horizon_s"] is not None:
        return "NOT proven for the true attitude; proven for the law's own"
    return PROVEN


def _truth_deg(system: LoopSystem, claim: FlightClaim) -> tuple[list[float | None] | None, str]:
    """Return the bounds of the true attitude [deg], or `None` and the reason why there are none."""
    if system.tilt is not None:
        return [*map(degrees_up, gravity_aided_truth(system, claim.box)), None], ""
    if claim.horizon is None:
        return None, "without a horizon the truth has no bound: gyros do not observe attitude"
    moment = [claim.certified_fraction * value for value in claim.moment]
    free = claim.moment_class is InterSampleMoment.ANY
    disturbance = Disturbance(
        unseen=moment if free else [Fraction(0)] * 3,
        slope=claim.slope,
        steps=math.ceil(claim.horizon / system.dt) + 1,
        risk=claim.risk / 2,
    )
    case, box = make_case(system, claim), claim.box
    try:
        if not is_strapdown(system):
            norms = [axis_norms(system, axis, claim.samples) for axis in range(3)]
            box, disturbance = strapdown_box(system, norms, case, box, disturbance, claim.samples)
        truth = truth_bound(system, case, box, disturbance)
    except Refusal as refusal:
        return None, str(refusal)
    return [degrees_up(value) for value in truth], ""


def _statement(system: LoopSystem, claim: FlightClaim, figures: Figures, why: str) -> str:
    moment = list_down(claim.certified_fraction * value for value in claim.moment)
    words = (
        f"law '{system.name}' keeps its own attitude within {list_up(figures['estimate_deg'])} deg for ever and its "
        f"torque below {list_up(figures['torque_nm'])} N*m, under any moment within {moment} N*m"
    )
    if claim.inertia_spread or claim.lag_spread:
        inertia, lag = percent_down(claim.inertia_spread), percent_down(claim.lag_spread)
        words += f", whatever the constant inertia within {inertia} % and the lag within {lag} %"
    else:
        words += ", with nominal inertia and lag"
    if claim.noise:
        period = RISK_PERIOD if claim.horizon is None else claim.horizon
        words += f", with gyro noise of {print_down(claim.noise)} rad/s rms"
        words += f" but for a risk of {print_up(claim.risk)} in {print_down(period)} s"
    else:
        words += ", without gyro noise"
    return f"{words}; {why or _state_truth(system, claim, figures['truth_deg'] or [])}"


def _state_truth(system: LoopSystem, claim: FlightClaim, truth: list[float | None]) -> str:
    between = {
        InterSampleMoment.HELD: "a moment held over each sample",
        InterSampleMoment.SLOPE: f"slopes below {list_down(claim.slope)} N*m/s within a sample",
        InterSampleMoment.ANY: "a moment that is any function of time",
    }[claim.moment_class]
    bounds = list_up(value for value in truth if value is not None)
    if system.tilt is not None:
        words = f"the true roll and pitch stay within {bounds} deg for ever, under {between}"
        return f"{words}; the true heading has no bound: an accelerometer does not observe it"
    horizon = claim.horizon or Fraction(0)
    words = f"for {print_down(horizon)} s the true attitude stays within {bounds} deg, under {between}"
    if claim.moment_class is InterSampleMoment.ANY:
        moments = [claim.certified_fraction * value for value in claim.moment]
        blind = blind_angles(system, moments, math.floor(horizon / system.dt))
        angles = ", ".join(print_down(math.degrees(value), 3) for value in blind)
        words += f" (a square wave in step with the samples turns any law of this gyro by {angles} deg, unseen)"
    return words


def _list_asked(claim: FlightClaim) -> list[float] | None:
    """Return the moment [N*m] of which only a part is proved; `None` if the whole is."""
    return None if claim.certified_fraction == 1 else [float_up(value) for value in claim.moment]


def _assumptions(system: LoopSystem, claim: FlightClaim) -> Assumptions:
    period = RISK_PERIOD if claim.horizon is None else float_down(claim.horizon)
    sensors = "gyro without bias" if system.tilt is None else "gyro and accelerometer without bias and noise"
    return {
        "plant": "exact nonlinear rigid body on a stand with this damping per inertia, first-order actuators, "
        f"{sensors}, float32 on the wire",
        "air": "any wind whose moments stay within the bound",
        "law": system.name,
        "moment_N_m": [float_down(claim.certified_fraction * value) for value in claim.moment],
        "moment_asked_N_m": _list_asked(claim),
        "moment_between_samples": claim.moment_class.value,
        "moment_slope_N_m_s": [float_down(value) for value in claim.slope] if max(claim.slope) else None,
        "start": "at rest, level, all states of law and loops 0",
        "sample_time_s": float(system.dt),
        "delay_samples": 1,
        "horizon_s": None if claim.horizon is None else float_down(claim.horizon),
        "inertia_kg_m2": [float(value) for value in system.inertia],
        "actuator_lag_s": float(system.lag),
        "inertia_spread": float_down(claim.inertia_spread),
        "actuator_lag_spread": float_down(claim.lag_spread),
        "rate_damping_per_s": [float(value) for value in system.damping],
        "noise_rad_s": float_down(claim.noise),
        "noise_probability": float_up(claim.risk),
        "noise_period_s": period if claim.noise else None,
    }


def degrees_up(angle: Fraction) -> float:
    """Return an angle [rad] in degrees, not rounded down."""
    return math.ceil(1e6 * math.degrees(float(angle)) + 1e-3) / 1e6


def read_bounds(name: str, values: object, count: int = 3) -> list[Fraction]:
    """Return numbers of the evidence, none negative; refuse anything else."""
    if not isinstance(values, list) or len(values) != count:
        raise Refusal(f"{name} must be {count} numbers")
    numbers = [finite(name, value) for value in values]
    if min(numbers) < 0:
        raise Refusal(f"{name} has a negative number")
    return numbers
