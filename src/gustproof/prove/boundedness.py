"""Certified boxes of flights: the law file, sampled and a sample late, on the nonlinear vehicle, under bounded moments.

The producer grows a box until it maps into itself. What the box proves is said by the check alone, see
`gustproof.checker.estimate_box` and `gustproof.checker.truth_drift`.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from firmware_model.config.files import read_text, write_toml
from firmware_model.config.vehicle import Vehicle, load_vehicle, vehicle_path
from gustproof.checker.estimate_box import Box, EstimateCase, is_rate_unlimited, is_within_limits
from gustproof.checker.evidence import check_certificate
from gustproof.checker.evidence_types import ChanceEvidence, Figures, FlightEvidence
from gustproof.checker.flight_box import (
    KIND,
    PROVEN,
    FlightClaim,
    InterSampleMoment,
    Norms,
    count_signals,
    flight_norms,
    make_case,
    map_flight,
    name_verdict,
    read_claim,
    spread_system,
)
from gustproof.checker.kernel_norms import LONGEST
from gustproof.checker.system import LoopSystem, Refusal, read_system, sha256
from gustproof.law.form import Law, law_path, load_law
from gustproof.robust.gain.certificate import Sealed

_ROUNDS = 400
"""Most rounds of growth; a box that has not settled by then counts as open."""
_MIN_ROUNDS = 12
"""Rounds after which the steps of a box that settles become shorter: a change has passed through all signals."""
_GROWTH = Fraction(1, 10**6)
"""[-] relative widening of a box in each round, so that it closes with slack."""
_TOLERANCE = Fraction(1, 1000)
"""[-] relative tolerance of the bisection for the largest part of the moment."""
_MIN_PART = Fraction(1, 1 << 14)
"""[-] part of the moment below which the search gives up."""
_INERTIA_CELLS, _LAG_CELLS = 24, 32
"""Cells that cover spreads of inertia and lag; more of them cost time and tighten the box."""
_LEVELLED_SAMPLES = 32_768
"""The same for a law that reads tilt: more of them tighten the box."""
_FIRST_SAMPLES = 512
"""Simulated samples of the norms, doubled until the tail is bounded."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class FlightCertificate(Sealed):
    """A proven box of a flight, or the reason why there is none; all but the evidence is what the check says of it.

    Examples
    --------
    >>> from gustproof import certify_boundedness
    >>> certificate = certify_boundedness("hinf-scheduled", "paper", moment=(0.65, 0.65, 0.3), horizon=60.0)
    >>> (certificate.proven, certificate.certified_fraction, certificate.assumes["delay_samples"])
    (True, 1.0, 1)
    """

    proven: bool
    """True if the check accepted the evidence, for `certified_fraction` of the moment. False is an ordinary result."""
    statement: str
    """The proved claim in words, or the reason why nothing is proved."""
    certified_fraction: float | None
    """[-] certified part of the moment, at most 1; `None` without a proof."""
    estimate_deg: list[float] | None
    """[deg] bounds of the law's own phi, theta, psi for ever."""
    truth_deg: list[float | None] | None
    """[deg] bounds of the true phi, theta, psi within the horizon; `None` if there are none.

    Of a law that reads tilt those of phi and theta hold for ever, and psi has none.
    """
    torque_nm: list[float] | None
    """[N*m] B, bounds of the torque that the law, or the loop behind its rates, demands."""
    moment_class: InterSampleMoment
    """Class of the moment between samples, on which the bounds of the truth rest."""
    assumes: dict[str, Any]
    """Assumptions by name."""
    evidence: FlightEvidence | ChanceEvidence
    """Input of the check beside the law and vehicle files, as JSON values."""

    @property
    def is_whole(self) -> bool:
        """True if all that was asked is proven: the whole moment, and the true attitude if there is a horizon."""
        return self.verdict == PROVEN

    @property
    def verdict(self) -> str:
        """Verdict in words, with what is proven of it."""
        figures: Figures = {
            "part": 1.0 if self.certified_fraction is None else self.certified_fraction,
            "truth_deg": self.truth_deg,
        }
        return name_verdict(figures, self.assumes) if self.proven else "NOT proven"

    def lines(self) -> list[str]:
        """Return the verdict and the claim, whose bounds are rounded up."""
        return [self.verdict, f"claim: {self.claim}"]


def certify_boundedness(
    law: str | Path,
    vehicle: str | Path,
    *,
    moment: tuple[float, float, float] = (0.65, 0.65, 0.3),
    horizon: float | None = 60.0,
    moment_class: InterSampleMoment = InterSampleMoment.HELD,
    slope: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise: float = 0.0,
    risk: float = 1e-3,
    inertia_spread: float = 0.0,
    lag_spread: float = 0.0,
) -> FlightCertificate:
    """Return a certificate of the largest part of `moment` under which the flight provably stays in a box.

    Two statements are made, and never mixed. The law's own attitude, its commands and the rates stay in the box for
    ever. The true attitude leaves the law's by at most a drift over the horizon. No flight is simulated.

    Parameters
    ----------
    law
        Name of a shipped law or a law file: torque or rates from gyros, each axis by itself. A law of torque may read
        tilt from the accelerometer too: its box is proved without noise and spreads.
    vehicle
        Name of a shipped vehicle or a vehicle file, nominal; its gyro noise is ignored, see `noise`. A gyro's
        bias is refused.
    moment
        (3,) [N*m] B, bound of the disturbance moment about each axis.
    horizon
        [s] from rest and level attitude; `None` without limit, where the truth has no bound.
    moment_class
        Class of the moment between the samples.
    slope
        (3,) [N*m/s] B, largest slope within a sample, for the class `SLOPE`.
    noise
        [rad/s] rms of the white Gaussian noise of a gyro sample.
    risk
        [-] probability that the noise leaves its bounds within the horizon, or in 600 s without one. Unused without
        noise.
    inertia_spread
        [-] share of each moment of inertia within which it lies, constant and unknown.
    lag_spread
        [-] the same of the actuators' lag.

    Raises
    ------
    ConfigError, LawFileError
        If there is no such law or vehicle, or its file is not sound.
    ValueError
        If the law has another form, its loop is unstable, or a number is out of range.

    Examples
    --------
    >>> from gustproof import certify_boundedness
    >>> certificate = certify_boundedness("flagship", "paper", moment=(0.65, 0.65, 0.3), horizon=60.0)
    >>> [round(angle, 2) for angle in certificate.estimate_deg], [round(angle, 2) for angle in certificate.truth_deg]
    ([1.06, 1.27, 0.86], [1.16, 1.36, 0.97])
    """
    load_law(law)  # for the errors of files
    load_vehicle(vehicle)
    law_text, vehicle_text = read_text(law_path(law)), read_text(vehicle_path(vehicle))
    evidence: FlightEvidence = {
        "kind": KIND,
        "law_sha256": sha256(law_text),
        "vehicle_sha256": sha256(vehicle_text),
        "moment": list(moment),
        "part": 1.0,
        "moment_class": moment_class.value,
        "slope": list(slope),
        "horizon": horizon,
        "noise": noise,
        "risk": risk if noise else 0.0,
        "inertia_spread": inertia_spread,
        "lag_spread": lag_spread,
        "cells": [_INERTIA_CELLS if inertia_spread else 1, _LAG_CELLS if lag_spread else 1],
        "samples": 0,
        "box": [[0.0]] * 3,
    }
    try:
        claim = read_claim(evidence)
        system = spread_system(read_system(law_text, vehicle_text), claim)
        samples, norms = find_norms(system)
    except Refusal as refusal:
        raise ValueError(str(refusal)) from None
    part, box = _largest_part(system, claim, norms)
    evidence["part"], evidence["samples"] = float(part), samples
    evidence["box"] = [[float(value) for value in row] for row in box]
    nothing = f"no part of the moment is proven for law '{system.name}'"
    return judge_box(evidence, nothing, moment_class, law=law_text, vehicle=vehicle_text)


def certify_made(
    law: Law,
    vehicle: Vehicle,
    *,
    moment: tuple[float, float, float],
    horizon: float,
    inertia_spread: float,
    lag_spread: float,
) -> FlightCertificate:
    """Return the certificate of a law and a vehicle that need no files, see `certify_boundedness`."""
    with TemporaryDirectory() as folder:
        law_file, vehicle_file = Path(folder) / "law.json", Path(folder) / "vehicle.toml"
        law.save(law_file)
        write_toml(vehicle, vehicle_file)
        return certify_boundedness(
            law_file,
            vehicle_file,
            moment=moment,
            horizon=horizon,
            inertia_spread=inertia_spread,
            lag_spread=lag_spread,
        )


def judge_box(
    evidence: FlightEvidence | ChanceEvidence,
    nothing: str,
    moment_class: InterSampleMoment,
    *,
    law: str,
    vehicle: str,
    scenario: str | None = None,
) -> FlightCertificate:
    """Return the certificate that the judge makes of evidence; an unproven one without a box, or if it refuses.

    Parameters
    ----------
    evidence
        Evidence with its `box`, empty where none was found.
    nothing
        Statement of a certificate without a box.
    moment_class
        Class of the moment between the samples.
    law, vehicle, scenario
        Texts of the files that the evidence is about.
    """
    unproven = FlightCertificate(
        proven=False,
        statement=nothing,
        certified_fraction=None,
        estimate_deg=None,
        truth_deg=None,
        torque_nm=None,
        moment_class=moment_class,
        assumes={},
        evidence=evidence,
    )
    if not evidence["box"]:
        return unproven
    verdict = check_certificate(json.dumps(unproven.to_dict()), law=law, vehicle=vehicle, scenario=scenario)
    if not verdict.accepted:
        return replace(unproven, statement=verdict.reason)
    figures = verdict.figures
    return replace(
        unproven,
        proven=True,
        statement=verdict.reason,
        certified_fraction=figures.get("part"),
        estimate_deg=figures["estimate_deg"],
        truth_deg=figures["truth_deg"],
        torque_nm=figures["torque_nm"],
        assumes=verdict.assumes,
    )


def find_norms(system: LoopSystem) -> tuple[int, Norms]:
    """Return the least power of two of samples that bounds the tails, and the norms.

    Raises
    ------
    Refusal
        If the loop is unstable or too slow.
    """
    samples = _FIRST_SAMPLES if system.tilt is None else _LEVELLED_SAMPLES
    while True:
        try:
            return samples, flight_norms(system, samples)
        except Refusal:
            samples *= 2
            if samples > LONGEST:
                raise


def _largest_part(system: LoopSystem, claim: FlightClaim, norms: Norms) -> tuple[Fraction, Box]:
    """Return the largest part of the moment, at most 1, whose box closes, and the box; an empty one if none does."""
    case = make_case(system, claim)
    nothing = [[Fraction(0)] * count_signals(system) for _ in range(3)]
    whole = _grow_box(system, norms, case, nothing)
    if whole:
        return Fraction(1), whole
    low, high = Fraction(0), Fraction(1)
    best: Box = []
    while high - low > max(_TOLERANCE * high, _MIN_PART):
        middle = (low + high) / 2
        scaled = case._replace(moment=[middle * value for value in claim.moment])
        box = _grow_box(system, norms, scaled, best or nothing)
        if box:
            low, best = middle, box
        else:
            high = middle
    return low, best


def _grow_box(system: LoopSystem, norms: Norms, case: EstimateCase, box: Box) -> Box:
    return grow_box(system, case, box, lambda kept: map_flight(system, norms, case, kept))


def grow_box(system: LoopSystem, case: EstimateCase, box: Box, follow: Callable[[Box], Box]) -> Box:
    """Grow `box` until what follows of it lies inside and return it; an empty box if it does not settle.

    The map is convex and grows with the box: once the steps lengthen, they lengthen for good.
    """
    sizes = [sum(map(sum, box))]
    for _ in range(_ROUNDS):
        try:
            follows = follow(box)
        except ValueError:  # an angle is above 1 rad; later rounds only add to it
            return []
        kept = all(is_within_limits(system, row, axis) for axis, row in enumerate(box))
        if not (kept and is_rate_unlimited(system, case, box)):
            return []
        if _is_inside(follows, box):
            return box
        box = [[Fraction(float(value * (1 + _GROWTH))) for value in row] for row in follows]
        sizes.append(sum(map(sum, box)))
        if len(sizes) > _MIN_ROUNDS and sizes[-1] - sizes[-2] > sizes[-2] - sizes[-3]:
            return []
    return []


def _is_inside(inner: Box, outer: Box) -> bool:
    pairs = (pair for rows in zip(inner, outer, strict=True) for pair in zip(*rows, strict=True))
    return all(value <= bound for value, bound in pairs)
