"""Certified boxes of flights in a scenario's turbulence, at a stated risk.

The producer grows a box until it maps into itself; what it proves is said by `gustproof.checker.gaussian_box`.
"""

from pathlib import Path

from firmware_model.config.files import read_text
from firmware_model.config.scenario import load_scenario, scenario_path
from firmware_model.config.vehicle import load_vehicle, vehicle_path
from gustproof.checker.evidence_types import ChanceEvidence
from gustproof.checker.flight_box import InterSampleMoment
from gustproof.checker.gaussian_box import KIND, bound_flight, map_gaussian_box, read_scope
from gustproof.checker.system import Refusal, finite, sha256
from gustproof.law.form import law_path, load_law
from gustproof.prove.boundedness import FlightCertificate, find_norms, grow_box, judge_box


def certify_chance(law: str | Path, vehicle: str | Path, scenario: str | Path, risk: float = 1e-3) -> FlightCertificate:
    """Return a certificate of the box that a flight in a scenario's turbulence leaves with a `risk` at most.

    Own and true attitude, rates and commands stay in the box over the scenario, on the nonlinear vehicle, its gyro
    noisy. The certificate has no part, as nothing bounds the moment. No flight is simulated.

    Parameters
    ----------
    law
        Name of a shipped law or a law file: torque from gyros, each axis by itself, without a schedule.
    vehicle
        Name of a shipped vehicle or a vehicle file, nominal.
    scenario
        Name of a shipped scenario or a scenario file: turbulence alone, on the stand.
    risk
        [-] probability.

    Raises
    ------
    ConfigError, LawFileError
        If there is no such file, or it is not sound.
    ValueError
        If law, vehicle or scenario are outside the proof, the loop is unstable, or risk is no probability.

    Examples
    --------
    >>> from gustproof import certify_chance
    >>> certificate = certify_chance("flagship", "paper", "paper-turbulence", risk=1e-3)
    >>> certificate.proven, max(certificate.truth_deg) < 1.1
    (True, True)
    """
    load_law(law)  # for the errors of files
    load_vehicle(vehicle)
    load_scenario(scenario)
    paths = {"law": law_path(law), "vehicle": vehicle_path(vehicle), "scenario": scenario_path(scenario)}
    texts = {name: read_text(path) for name, path in paths.items()}
    try:
        system, air = read_scope(*texts.values())
        samples, _ = find_norms(system)
        flight = bound_flight(system, air, finite("risk", risk), samples)
    except Refusal as refusal:
        raise ValueError(str(refusal)) from None
    box = grow_box(flight.system, flight.case, flight.gaussian, lambda kept: map_gaussian_box(flight, kept)[0])
    evidence: ChanceEvidence = {
        "kind": KIND,
        "law_sha256": sha256(texts["law"]),
        "vehicle_sha256": sha256(texts["vehicle"]),
        "scenario_sha256": sha256(texts["scenario"]),
        "risk": risk,
        "samples": samples,
        "box": [[float(value) for value in row] for row in box],
    }
    nothing = f"no box is proven for law '{flight.system.name}' in this air"
    return judge_box(evidence, nothing, InterSampleMoment.HELD, **texts)
