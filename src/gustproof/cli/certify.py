"""The command `gustproof certify`: prove a bound, or check a certificate."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus, say
from gustproof.cli.options import AsJson, check_output, parse_positive_vector, print_json

if TYPE_CHECKING:
    from gustproof.certify.certificate import Certificate
    from gustproof.synthesis.designs import Design


_USAGE = "give a design with --angle-rad and --rate-rad-s, a law with --closure, or --check with a certificate"
_ASSUMPTIONS = {
    "leak_per_s": "leak [1/s]",
    "rate_damping_per_s": "rate damping [1/s]",
    "angle_rad": "angles up to [rad]",
    "rate_rad_s": "rates up to [rad/s]",
    "sample_time_s": "sample time [s]",
    "moment_N_m": "moment up to [N m]",
    "noise_rad_s": "gyro noise rms [rad/s]",
    "rho": "attitude and rates",
    "horizon_s": "duration [s]",
    "delay_samples": "delay [samples]",
    "noise_probability": "risk from noise",
}
"""Label of each assumption on a terminal; others keep their key."""
_UNBOUNDED = {"rho": "no assumption", "horizon_s": "unlimited", "delay_samples": "none"}
"""Text of an assumption that is `None`, "nothing" or 0."""


def certify(
    name: Annotated[
        str | None, typer.Argument(help="Name of a shipped design or law, or a file: design .toml, law .json.")
    ] = None,
    angle: Annotated[
        float | None, typer.Option("--angle-rad", help="Envelope: largest roll and pitch [rad], below pi/2.")
    ] = None,
    rate: Annotated[float | None, typer.Option("--rate-rad-s", help="Envelope: largest rates p, q, r [rad/s].")] = None,
    level: Annotated[float | None, typer.Option(help="Gain to prove [default: the least provable one].")] = None,
    closure: Annotated[
        bool,
        typer.Option(
            "--closure", help="Prove that the nonlinear flight stays in a box, under the moments of --moment."
        ),
    ] = False,
    moment: Annotated[
        str, typer.Option(help="Closure: largest moment about each axis, L,M,N [N m].")
    ] = "0.65,0.65,0.3",
    horizon: Annotated[float, typer.Option(help="Closure: length of the flight [s].")] = 60.0,
    exact_rho: Annotated[
        bool, typer.Option("--exact-rho", help="Controller with the airframe's A(rho) and exact knowledge of rho.")
    ] = False,
    slow: Annotated[
        bool, typer.Option("--slow", help="Bound the speeds of roll and pitch by the envelope's rates.")
    ] = False,
    leak: Annotated[
        float | None,
        typer.Option(help="Leak of the Euler kinematics [1/s] [default: the design's; closure: 0, as in the vehicle]."),
    ] = None,
    noise: Annotated[float, typer.Option(help="Closure: rms of the gyro's white noise in a sample [rad/s].")] = 0.0,
    risk: Annotated[float, typer.Option(help="Closure: probability that the noise leaves its bounds.")] = 1e-3,
    check_file: Annotated[
        Path | None, typer.Option("--check", help="Check a certificate in exact arithmetic, without a solver.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Name of a shipped vehicle, or a .toml file [default: the design's, or paper].")
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the certificate here (.json).")] = None,
    as_json: AsJson = False,
) -> None:
    """Prove a bound on the effect of disturbances and noise on a loop.

    With an envelope, the bound is the L2 gain from the design's weighted inputs (moment, gyro noise) to its weighted
    outputs (attitude error, command). It holds for every motion within the envelope, however fast. Gain 1 means that a
    disturbance as large as its weight costs no more than the weights allow. At hover the gain is the design's
    H-infinity norm; off hover the rotation couples the axes. A lower bound from simulation shows how tight the gain is.

    A solver only proposes the evidence. A result is called proven only after a check in exact rational arithmetic. The
    statement is about the design's own plant, or one with the given leak, and its continuous controller. With
    `--exact-rho` that controller is scheduled: it rotates its own estimates by the airframe's A(rho). With `--slow` the
    proof uses bounds on the speeds of roll and pitch, which follow from the envelope's rates. It is tighter and takes
    half a minute.

    With `--closure` the statement is about the law file that flies, sampled and one sample late, on the nonlinear
    vehicle. The flight starts from rest and ends within the horizon. Under any moment within the certified part of the
    budget, angles, rates and commands stay in a box. Nothing is assumed of the motion. The gain is the certified part
    of the budget, at most 1.

    The output lists the assumptions of each statement. Exit status: 0 proven, 1 not proven, 2 bad input.

        gustproof certify hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 -o certificate.json

        gustproof certify hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 --level 0.25

        gustproof certify hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 --slow

        gustproof certify hinf-d1 --angle-rad 0.3 --rate-rad-s 0.5 --exact-rho --leak 0.05

        gustproof certify hinf-scheduled --closure --moment 0.65,0.65,0.3 --horizon 60

        gustproof certify --check certificate.json
    """
    if check_file is not None:
        if name is not None:
            raise ConfigError("--check takes the certificate's file alone")
        raise typer.Exit(_check(check_file, as_json=as_json).value)
    if name is None or (angle is None) != (rate is None) or closure == (angle is not None):
        raise ConfigError(_USAGE)
    if closure and (exact_rho or slow or level is not None):
        raise ConfigError("--exact-rho, --slow and --level are for a gain; a closure takes the law file as it is")
    check_output(output, ".json", "a certificate")
    if closure:
        bound = parse_positive_vector("--moment", moment)
        options = {"horizon": horizon, "leak": leak or 0.0, "noise": noise, "risk": risk}
        certificate = _certify_boundedness(name, vehicle or "paper", bound, **options)
    else:
        envelope = {"angle": angle, "rate": rate, "rate_bounded": slow, "level": level}
        certificate = _certify_gain(name, vehicle, leak, exact_rho=exact_rho, **envelope)
    if output is not None and certificate.proven:
        certificate.save(output)
    _show(name, certificate, output, as_json=as_json)
    raise typer.Exit((ExitStatus.DONE if certificate.proven else ExitStatus.REQUIREMENT_FAILED).value)


def _find_design(name: str) -> "Design":
    """Return the design of that name, or the design of the shipped law of that name."""
    from gustproof.law.form import list_laws
    from gustproof.synthesis.designs import list_designs, load_design

    if name not in list_laws():
        return load_design(name)
    made_from = {design.law: design for design in map(load_design, list_designs())}
    if name not in made_from:
        # a gain can be proved of torque from gyros alone, to hold level
        gains = (law for law, d in made_from.items() if d.rate_loop_lag is None and d.W_l is None and d.W_r is None)
        raise ConfigError(
            f"law '{name}' was made from no design, and a gain needs the weights of one; give one of {', '.join(gains)}"
        )
    return made_from[name]


def _certify_gain(
    name: str, vehicle: str | None, leak: float | None, *, exact_rho: bool, **options: Any
) -> "Certificate":
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.certify.gain.l2_gain import certify_gain
    from gustproof.synthesis.derive import derive
    from gustproof.synthesis.designs import design_problem

    design = _find_design(name)
    airframe = load_vehicle(vehicle or design.vehicle)
    _, report = derive(design, airframe)
    if leak is not None and not 0.0 < leak < math.inf:
        raise ConfigError(
            f"--leak: is {leak}, must be positive: without leak the attitude integrates and no gain is finite"
        )
    try:
        problem = report.problem if leak is None else design_problem(replace(design, leak=leak), airframe)
        return certify_gain(problem, report.result.controller, scheduled=exact_rho or design.scheduled, **options)
    except ValueError as error:
        raise ConfigError(f"design {design.name}: {error}") from None


def _certify_boundedness(
    law: str, vehicle: str, moment: tuple[float, float, float], *, horizon: float, leak: float, **noise: float
) -> "Certificate":
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.certify.boundedness import certify_boundedness
    from gustproof.certify.check.invariant_box import SIGNALS
    from gustproof.falsify.worst_case import reached_share
    from gustproof.law.form import load_law

    flown, airframe = load_law(law), load_vehicle(vehicle)
    try:
        certificate = certify_boundedness(flown, airframe, moment=moment, horizon=horizon, leak=leak, **noise)
        if not certificate.proven or certificate.gain is None or leak:  # a vehicle with a leak cannot be flown
            return certificate
        L, M, N = (certificate.gain * limit for limit in moment)
        angles_rad = [row[SIGNALS.index("E")] for row in certificate.evidence["box"]]
        share = reached_share(flown, airframe, angles_rad=angles_rad, budget=(L, M, N), duration_s=horizon)
        return replace(certificate, lower_bound=share)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _check(path: Path, *, as_json: bool) -> ExitStatus:
    from firmware_model.config.files import parse_json, read_text
    from gustproof.certify.check.evidence import FORMAT, check_certificate

    try:
        text = read_text(path)
        claimed = parse_json(text)
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON: {error}") from None
    if not isinstance(claimed, dict) or claimed.get("format") != FORMAT:
        raise ConfigError(f"{path}: not a certificate: its format must be '{FORMAT}'")
    verdict = check_certificate(text)
    if as_json:
        keys = ("statement", "gain", "lower_bound", "assumes") if verdict.accepted else ()
        figures = {key: claimed[key] for key in keys if key in claimed}
        print_json({"proven": verdict.accepted, "reason": verdict.reason, **figures})
    elif verdict.accepted:
        say(f"proven: {claimed['statement']}")
        say(verdict.reason)
        _show_assumptions(claimed["assumes"])
    else:
        say(f"refused: {verdict.reason}")
    return ExitStatus.DONE if verdict.accepted else ExitStatus.REQUIREMENT_FAILED


def _show(name: str, certificate: "Certificate", output: Path | None, *, as_json: bool) -> None:
    gain = certificate.gain
    if as_json:
        figures = {"gain": gain, "lower_bound": certificate.lower_bound, "proven": certificate.proven}
        print_json({**figures, "assumes": certificate.assumes, "statement": certificate.statement})
        return
    print(f"{name}: {'proven' if certificate.proven else 'NOT proven'}: {certificate.statement}")
    if certificate.lower_bound:  # 0 if nothing was simulated
        print(_describe_lower_bound(certificate))
    _show_assumptions(certificate.assumes)
    if output is not None:
        unproven = "no certificate is written: there is no proof to check"
        print(f"certificate in {output}" if certificate.proven else unproven)


def _describe_lower_bound(certificate: "Certificate") -> str:
    reached, gain = certificate.lower_bound, certificate.gain
    if certificate.evidence.get("kind") == "closure":
        line = f"the worst simulated flight used {100.0 * reached:.2g} % of the angles of this box"
        return f"{line}, so the claimed box is false" if reached > 1.0 else line
    line = f"a simulation reached {reached:.4g}"
    return f"{line}, so the claimed bound {gain:.4g} is false" if gain is not None and reached > gain else line


def _show_assumptions(assumes: dict[str, Any]) -> None:
    print("assumptions")
    for key, value in assumes.items():
        unbounded = key in _UNBOUNDED and value in (None, 0, "nothing")
        text = _UNBOUNDED[key] if unbounded else "none" if value is None else value
        say(f"  {_ASSUMPTIONS.get(key, key):22} {text}")
