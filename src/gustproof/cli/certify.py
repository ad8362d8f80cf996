"""The command `gustproof certify`: prove a bound, or check a certificate."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus, say
from gustproof.cli.options import (
    AsJson,
    check_output,
    complete,
    parse_positive_vector,
    print_json,
    refuse_given,
    working,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from gustproof.certify.boundedness import FlightCertificate
    from gustproof.certify.certificate import Certificate
    from gustproof.certify.check.evidence import CheckResult
    from gustproof.certify.gain.parts import Delay, Part
    from gustproof.law.form import Law
    from gustproof.lti.rational import RationalMatrix
    from gustproof.lti.state_space import LinearSystem
    from gustproof.model.interconnection import Interconnection
    from gustproof.model.lft import Uncertain
    from gustproof.synthesis.designs import Design


_USAGE = "give a law, a design with --angle-rad and --rate-rad-s, or --check with a certificate"
_ASSUMPTIONS = {
    "leak_per_s": "leak [1/s]",
    "rate_damping_per_s": "rate damping [1/s]",
    "angle_rad": "angles up to [rad]",
    "rate_rad_s": "rates up to [rad/s]",
    "sample_time_s": "sample time [s]",
    "moment_N_m": "moment up to [N m]",
    "moment_between_samples": "moment in a sample",
    "moment_slope_N_m_s": "slope in it [N m/s]",
    "noise_rad_s": "gyro noise rms [rad/s]",
    "inertia_kg_m2": "inertia [kg m^2]",
    "actuator_lag_s": "actuator lag [s]",
    "system_sha256": "SHA-256 of the system",
    "speeds_per_s": "speeds up to [1/s]",
    "inertia_spread": "inertia within share",
    "actuator_lag_spread": "lag within share",
    "rho": "attitude and rates",
    "horizon_s": "duration [s]",
    "delay_samples": "delay [samples]",
    "delay_s": "delay [s]",
    "noise_probability": "risk from noise",
    "noise_period_s": "risk counts over [s]",
    "wind_20ft_m_s": "wind at 20 ft [m/s]",
    "airspeed_m_s": "it passes at [m/s]",
    "altitude_m": "altitude [m]",
    "gust_scale": "factor on gusts",
}
"""Label of each assumption on a terminal; others keep their key."""
_UNBOUNDED = {"horizon_s": "unlimited", "delay_samples": "none"}
"""Text of an assumption that is `None` or 0."""


class _Loop(NamedTuple):
    """Loop of a gain."""

    loop: "Uncertain"
    """Loop, closed by its parameters and parts."""
    speeds: dict[str, float] | None
    """[1/s] speeds of its normalised parameters, if bounded."""
    parts: "dict[str, Part]"
    """Parts of the command's path, by name."""
    radius: "dict[str, RationalMatrix] | None"
    """Distances of its numbers from those without rounding, of a law file's; `None` for a design's."""


def certify(
    context: typer.Context,
    name: Annotated[
        str | None,
        typer.Argument(
            help="Name of a shipped design or law, or a file: design .toml, law .json (a scheduled one for a gain).",
            autocompletion=complete("design"),
        ),
    ] = None,
    angle: Annotated[
        float | None, typer.Option("--angle-rad", help="Envelope: largest roll and pitch [rad], below pi/2.")
    ] = None,
    rate: Annotated[float | None, typer.Option("--rate-rad-s", help="Envelope: largest rates p, q, r [rad/s].")] = None,
    level: Annotated[float | None, typer.Option(help="Gain to prove [default: the least provable one].")] = None,
    moment: Annotated[str, typer.Option(help="Flight: largest moment about each axis, L,M,N [N m].")] = "0.65,0.65,0.3",
    moment_class: Annotated[
        str, typer.Option(help="Flight: the moment between two samples: held, slope (see --slope), or any function.")
    ] = "held",
    slope: Annotated[
        str | None, typer.Option(help="Flight: largest slope of the moment within a sample, L,M,N [N m/s].")
    ] = None,
    horizon: Annotated[
        float, typer.Option(help="Flight: how long the true attitude is bounded [s]; inf bounds the law's own alone.")
    ] = 60.0,
    exact_rho: Annotated[
        bool, typer.Option("--exact-rho", help="Controller with the airframe's A(rho) and exact knowledge of rho.")
    ] = False,
    slow: Annotated[
        bool, typer.Option("--slow", help="Bound the speeds of roll and pitch by the envelope's rates.")
    ] = False,
    leak: Annotated[
        float | None,
        typer.Option(help="Gain: leak of the plant's Euler kinematics [1/s] [default: the design's]."),
    ] = None,
    delay_ms: Annotated[
        float | None,
        typer.Option("--delay-ms", help="Gain: the command is late by a constant time from 0 to this [ms]."),
    ] = None,
    saturation: Annotated[
        float | None,
        typer.Option(help="Gain: torque is limited, and commands are at most so many times the limit; inf for any."),
    ] = None,
    noise: Annotated[float, typer.Option(help="Flight: rms of the gyro's white noise in a sample [rad/s].")] = 0.0,
    risk: Annotated[
        float,
        typer.Option(
            help="Flight: probability that the noise leaves its bounds in the horizon, or in 600 s. With --air, that"
            " the attitude leaves the box."
        ),
    ] = 1e-3,
    air: Annotated[
        str | None,
        typer.Option(
            help="Prove the box for the turbulence of this scenario, a name or a .toml file. With --check: that of a"
            " certificate."
        ),
    ] = None,
    inertia_spread: Annotated[
        float, typer.Option(help="Flight: every constant inertia within this share, such as 0.2.")
    ] = 0.0,
    lag_spread: Annotated[float, typer.Option(help="Flight: every constant actuator lag within this share.")] = 0.0,
    check_file: Annotated[
        Path | None, typer.Option("--check", help="Check a certificate in exact arithmetic, without a solver.")
    ] = None,
    law: Annotated[
        str | None, typer.Option(help="With --check: the law of a flight's certificate, a name or a .json file.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Name of a shipped vehicle, or a .toml file [default: the design's, or paper].",
            autocompletion=complete("vehicle"),
        ),
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
    `--exact-rho` that controller is scheduled: it rotates its own estimates by the airframe's A(rho). Of a law file
    from `gustproof design --method lpv` it is the continuous controller of the file's schedule, with exact rho, and
    weights are those of its design. With `--slow` the proof uses bounds on the speeds of roll and pitch, which follow
    from the envelope's rates. It is tighter and takes half a minute.

    With --delay-ms the gain holds for every constant delay of the command up to that time. With --saturation 1.5 torque
    is limited, and commands are at most 1.5 times the limit. Beyond that a saturated loop is an open loop. So
    --saturation inf is refused if plant or controller is not stable alone, and its gain is never below the open loop's.
    Both are proved by integral quadratic constraints. A law without an envelope has the local statement:
    below a bounded moment its commands do not reach their limits.

    A law without an envelope is proved to fly within a box: its file, sampled and one sample late, on the nonlinear
    vehicle without leak. Two statements are made. The law's own attitude, its rates and commands stay in the box for
    ever, under any moment within --moment. The true attitude leaves that of a strapdown law by at most a drift, which
    grows with the horizon: a gyro does not observe attitude. Of a law that reads the accelerometer the true roll and
    pitch stay in a box for ever, and the heading has no bound. That is without noise and spreads. Nothing is assumed of
    the motion. The part is the certified share of the moment, at most 1. --check derives the loop again from the law
    and vehicle files. Of a gain, given the design and its envelope, it proves the gain of the loop derived again, and
    of all within its rounding. It flies the lower bound again.

    With --air the box is that of the scenario's turbulence and gyro noise, which the true attitude leaves over its
    duration with --risk at most. The linear part is Gaussian, with tails summed over all samples and axes; the rest is
    bounded. It is proved of a strapdown law of torque. Of others a linear Gaussian model predicts it, and the output
    says so.

    The output lists the assumptions of each statement. Exit status: 0 proven, or predicted with --air, 1 not proven, 2
    bad input.

        gustproof certify hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 -o certificate.json

        gustproof certify hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 --level 0.25

        gustproof certify hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 --slow

        gustproof certify hinf-d1 --angle-rad 0.3 --rate-rad-s 0.5 --exact-rho --leak 0.05

        gustproof certify hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 --delay-ms 8 --saturation 1.5

        gustproof certify flagship --moment 0.65,0.65,0.3 --horizon 60 -o flight.json

        gustproof certify flagship --horizon inf --noise 0.0036 --risk 1e-3

        gustproof certify flagship --air paper-turbulence --risk 1e-3 -o chance.json

        gustproof certify my-lpv.json --angle-rad 0.3 --rate-rad-s 0.5

        gustproof certify --check certificate.json

        gustproof certify hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 --check certificate.json

        gustproof certify my-lpv.json --angle-rad 0.3 --rate-rad-s 0.5 --check certificate.json

        gustproof certify --check flight.json --law flagship --vehicle paper

        gustproof certify --check chance.json --law flagship --vehicle paper --air paper-turbulence
    """
    if air is not None and check_file is None:
        _bound_chance(context, name, vehicle or "paper", air, risk, output, as_json=as_json)
        return
    envelope = _parse_envelope(angle, rate)
    gain: dict[str, Any] = {"leak": leak, "exact_rho": exact_rho, "slow": slow}
    gain |= {"delay_ms": delay_ms, "saturation": saturation}
    if check_file is not None:
        if (name is None) != (envelope is None):
            raise ConfigError("--check takes a gain's design with its envelope, or a flight's --law and --vehicle")
        derived = None
        with working(f"checking {check_file}", quiet=as_json):
            if name is not None and envelope is not None:
                derived = _derive_loop(name, vehicle, *envelope, **gain)
            status = _check(check_file, law, None if name else vehicle, air, derived, as_json=as_json)
        raise typer.Exit(status.value)
    if name is None or law is not None:
        raise ConfigError(_USAGE)
    check_output(output, ".json", "a certificate")
    certificate: Certificate | FlightCertificate
    if envelope is not None:
        with working(f"proving a gain of {name}", quiet=as_json):
            certificate = _certify_gain(name, vehicle, *envelope, level=level, **gain)
    else:
        gains = ("exact_rho", "slow", "level", "leak", "delay_ms", "saturation")
        refuse_given(context, gains, "a flight takes the law file as it is, and proves no gain")
        with working(f"proving a box for {name}", quiet=as_json):
            certificate = _certify_flight(
                name,
                vehicle or "paper",
                moment,
                horizon,
                moment_class=moment_class,
                slope=slope,
                noise=noise,
                risk=risk,
                inertia_spread=inertia_spread,
                lag_spread=lag_spread,
            )
    if output is not None and certificate.proven:
        certificate.save(output)
    _show(name, certificate, output, as_json=as_json)
    raise typer.Exit((ExitStatus.DONE if certificate.proven else ExitStatus.REQUIREMENT_FAILED).value)


def _bound_chance(
    context: typer.Context,
    name: str | None,
    vehicle: str,
    air: str,
    risk: float,
    output: Path | None,
    *,
    as_json: bool,
) -> None:
    """Print the box that is proved for the air, or the one that the linear Gaussian model predicts, and why."""
    from gustproof.certify.air_box import certify_chance

    meant = {"name", "vehicle", "air", "risk", "output", "as_json"}
    refuse_given(
        context, sorted(set(context.params) - meant), "--air takes all but law, vehicle and risk from its file"
    )
    if name is None:
        raise ConfigError(_USAGE)
    check_output(output, ".json", "a certificate")
    with working(f"proving a box for {name}", quiet=as_json):
        try:
            found = certify_chance(name, vehicle, air, risk)
            reason = found.statement
        except ValueError as error:
            found, reason = None, str(error)
    if found is None or found.truth_deg is None:
        _predict(name, vehicle, air, risk, reason, as_json=as_json)
        return
    if output is not None:
        found.save(output)
    if as_json:
        figures: dict[str, Any] = {"attitude_deg": found.truth_deg, "estimate_deg": found.estimate_deg, "risk": risk}
        figures |= {"horizon_s": found.assumes["horizon_s"], "air": air}
        print_json({"proven": True, **figures, "assumes": found.assumes, "statement": found.statement})
        return
    _show(name, found, output, as_json=False)


def _predict(name: str, vehicle: str, air: str, risk: float, reason: str, *, as_json: bool) -> None:
    """Print the box that the linear Gaussian model predicts, and the reason why none is proved."""
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.law.form import load_law
    from gustproof.performance.chance import attitude_box

    try:
        found = attitude_box(load_law(name), load_vehicle(vehicle), load_scenario(air), risk)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    if as_json:
        figures = {"attitude_deg": found.attitude_deg, "risk": found.risk, "horizon_s": found.horizon_s, "air": air}
        print_json({"proven": False, **figures, "assumes": found.assumes, "statement": reason})
        return
    angles = ", ".join(f"{math.ceil(1e3 * angle) / 1e3:g}" for angle in found.attitude_deg)
    claim = f"|phi|, |theta|, |psi| stay below {angles} deg for {found.horizon_s:g} s of {air}"
    say(f"{name}: predicted, not proven: {claim} with probability {1.0 - found.risk:.9g} or more")
    say(f"no proof: {reason}")
    _show_assumptions(found.assumes)


def _parse_envelope(angle: float | None, rate: float | None) -> tuple[float, float] | None:
    """Return largest angle [rad] and rate [rad/s]; `None` without them."""
    if angle is None and rate is None:
        return None
    if angle is None or rate is None:
        raise ConfigError(_USAGE)
    return angle, rate


def _find_design(name: str) -> "Design":
    """Return the design of that name, or the design of the shipped law of that name."""
    from gustproof.law.form import list_laws
    from gustproof.synthesis.designs import list_designs, load_design

    if name not in list_laws():
        return load_design(name)
    made_from = {design.law: design for design in map(load_design, list_designs())}
    if name not in made_from:
        allowed = ", ".join(law for law, design in made_from.items() if _has_gain(design))
        raise ConfigError(
            f"law '{name}' was made from no design, and a gain needs the weights of one; give one of {allowed}"
        )
    return made_from[name]


def _has_gain(design: "Design") -> bool:
    """Return whether a gain can be proved for a design: torque from gyros alone, to hold level."""
    return design.rate_loop_lag is None and design.W_l is None and design.W_r is None


def _scheduled_law(name: str) -> "tuple[Design, Law]":
    """Return the design of a scheduled law's file, and the law."""
    from gustproof.law.form import load_law
    from gustproof.law.schedule import sampled_controller
    from gustproof.synthesis.designs import list_designs, load_design

    law = load_law(name)
    design = law.provenance.design.split(":")[0]
    try:
        sampled_controller(law)
        if design not in list_designs():
            raise ValueError(f"law '{law.name}' was made from no shipped design, and a gain needs the weights of one")
    except ValueError as error:
        raise ConfigError(f"{name}: {error}; give the design") from None
    return load_design(design), law


def _certify_gain(
    name: str,
    vehicle: str | None,
    angle: float,
    rate: float,
    *,
    level: float | None,
    leak: float | None,
    exact_rho: bool,
    slow: bool,
    delay_ms: float | None,
    saturation: float | None,
) -> "Certificate":
    from gustproof.certify.gain.l2_gain import certify_gain

    design, problem, controller = _named_loop(name, vehicle, leak)
    delay = _parse_delay(delay_ms)
    try:
        return certify_gain(
            problem,
            controller,
            angle=angle,
            rate=rate,
            scheduled=exact_rho or design.scheduled,
            rate_bounded=slow,
            level=level,
            delay=delay,
            saturation=saturation,
        )
    except ValueError as error:
        raise ConfigError(f"design {design.name}: {error}") from None


def _parse_delay(delay_ms: float | None) -> "Delay | None":
    from gustproof.certify.gain.parts import Delay

    if delay_ms is None:
        return None
    try:
        return Delay(largest=1e-3 * delay_ms)
    except ValueError as error:
        raise ConfigError(f"--delay-ms: {error}") from None


def _named_loop(
    name: str, vehicle: str | None, leak: float | None
) -> "tuple[Design, Interconnection, LinearSystem | Law]":
    """Return a design, its problem, with another leak if given, and its controller; or a scheduled law and its own."""
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.synthesis.derive import derive
    from gustproof.synthesis.designs import design_problem

    design, law = _scheduled_law(name) if name.endswith(".json") else (_find_design(name), None)
    airframe = load_vehicle(vehicle or design.vehicle)
    if leak is not None and not 0.0 < leak < math.inf:
        raise ConfigError(
            f"--leak: is {leak}, must be positive: without leak the attitude integrates and no gain is finite"
        )
    problem = design_problem(design if leak is None else replace(design, leak=leak), airframe)
    return design, problem, derive(design, airframe)[1].result.controller if law is None else law


def _derive_loop(
    name: str,
    vehicle: str | None,
    angle: float,
    rate: float,
    *,
    leak: float | None,
    exact_rho: bool,
    slow: bool,
    delay_ms: float | None,
    saturation: float | None,
) -> "_Loop":
    """Return the loop that a certificate of a design or of a scheduled law is about."""
    from gustproof.certify.gain.l2_gain import attitude_loop, command_parts, envelope_speeds, law_rounding
    from gustproof.model.rotational import Envelope

    design, problem, controller = _named_loop(name, vehicle, leak)
    delay, scheduled = _parse_delay(delay_ms), exact_rho or design.scheduled
    try:
        envelope = Envelope(angle=angle, rate=rate)
        loop = attitude_loop(problem, controller, envelope, scheduled=scheduled, delay=delay, saturation=saturation)
        radius = law_rounding(problem, controller, envelope, loop, delay=delay, saturation=saturation)
        kept = design.leak if leak is None else leak
        speeds = envelope_speeds(angle, rate, leak=kept) if slow else None
        return _Loop(loop, speeds, command_parts(delay, saturation), radius)
    except ValueError as error:
        raise ConfigError(f"design {design.name}: {error}") from None


def _certify_flight(
    law: str,
    vehicle: str,
    moment: str,
    horizon: float,
    *,
    moment_class: str,
    slope: str | None,
    noise: float,
    risk: float,
    inertia_spread: float,
    lag_spread: float,
) -> "FlightCertificate":
    from gustproof.certify.boundedness import certify_boundedness
    from gustproof.certify.check.flight_box import MomentClass

    classes = [member.value for member in MomentClass]
    if moment_class not in classes:
        raise ConfigError(f"--moment-class: is '{moment_class}', must be one of {', '.join(classes)}")
    try:
        return certify_boundedness(
            law,
            vehicle,
            moment=parse_positive_vector("--moment", moment),
            horizon=None if horizon == math.inf else horizon,
            moment_class=MomentClass(moment_class),
            slope=(0.0, 0.0, 0.0) if slope is None else parse_positive_vector("--slope", slope),
            noise=noise,
            risk=risk,
            inertia_spread=inertia_spread,
            lag_spread=lag_spread,
        )
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _check(
    path: Path,
    law: str | None,
    vehicle: str | None,
    air: str | None,
    derived: "_Loop | None",
    *,
    as_json: bool,
) -> ExitStatus:
    """Print the verdict on a certificate; that of a gain is about the `derived` loop, if given, which flies again."""
    from firmware_model.config.files import parse_json, read_text
    from firmware_model.config.scenario import scenario_path
    from firmware_model.config.vehicle import vehicle_path
    from gustproof.certify.check.evidence import FORMAT, check_certificate
    from gustproof.certify.gain.l2_gain import derived_loop, lower_bound
    from gustproof.law.form import law_path

    if derived is not None and air is not None:
        raise ConfigError("--check of a gain takes no --air")
    try:
        text = read_text(path)
        claimed = parse_json(text)
        law_text = _read_given(law, law_path)
        vehicle_text = _read_given(vehicle, vehicle_path)
        air_text = _read_given(air, scenario_path)
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON: {error}") from None
    if not isinstance(claimed, dict) or claimed.get("format") != FORMAT:
        raise ConfigError(f"{path}: not a certificate: its format must be '{FORMAT}'")
    loop = None if derived is None else derived_loop(*derived)
    verdict = check_certificate(text, law=law_text, vehicle=vehicle_text, scenario=air_text, loop=loop)
    if verdict.accepted and derived is not None:
        verdict = _weigh(verdict, lower_bound(*derived[:3]))
    _show_verdict(verdict, as_json=as_json)
    return ExitStatus.DONE if verdict.accepted else ExitStatus.REQUIREMENT_FAILED


def _read_given(name: str | None, find: "Callable[[str], Path]") -> str | None:
    """Return the text of a file that `find` finds by its name; `None` without one."""
    from firmware_model.config.files import read_text

    return None if name is None else read_text(find(name))


def _weigh(verdict: "CheckResult", reached: float) -> "CheckResult":
    """Return the verdict on a gain with what a simulation `reached`; one that exceeds the gain refutes it."""
    gain = verdict.figures["gain"]
    if reached > gain:
        reason = f"a simulation reached {reached:.4g}, above the gain {gain:.4g}"
        return replace(verdict, accepted=False, reason=reason, figures={})
    return replace(verdict, figures={**verdict.figures, "lower_bound": reached})


def _show_verdict(verdict: "CheckResult", *, as_json: bool) -> None:
    if as_json:
        made = {"assumes": verdict.assumes} if verdict.accepted else {}
        print_json({"proven": verdict.accepted, "reason": verdict.reason, **verdict.figures, **made})
    elif verdict.accepted:
        say(f"proven: {verdict.reason}")
        if "lower_bound" in verdict.figures:
            print(f"a simulation of the derived loop reached {verdict.figures['lower_bound']:.4g}")
        _show_assumptions(verdict.assumes)
    else:
        say(f"refused: {verdict.reason}")


def _show(name: str, certificate: "Certificate | FlightCertificate", output: Path | None, *, as_json: bool) -> None:
    from gustproof.certify.boundedness import FlightCertificate

    if as_json:
        figures: dict[str, Any] = {"proven": certificate.proven}
        if isinstance(certificate, FlightCertificate):
            figures |= {
                "part": certificate.part,
                "estimate_deg": certificate.estimate_deg,
                "truth_deg": certificate.truth_deg,
                "moment_class": certificate.moment_class.value,
            }
        else:
            figures |= {"gain": certificate.gain, "lower_bound": certificate.lower_bound}
        print_json({**figures, "assumes": certificate.assumes, "statement": certificate.statement})
        return
    print(f"{name}: {'proven' if certificate.proven else 'NOT proven'}: {certificate.statement}")
    if not isinstance(certificate, FlightCertificate):
        print(_describe_lower_bound(certificate))
    _show_assumptions(certificate.assumes)
    if output is not None:
        print(
            f"certificate in {output}"
            if certificate.proven
            else "no certificate is written: there is no proof to check"
        )


def _describe_lower_bound(certificate: "Certificate") -> str:
    reached, gain = certificate.lower_bound, certificate.gain
    constrained = certificate.evidence.get("kind") == "constrained gain"
    line = f"a simulation{' or a linear member' if constrained else ''} reached {reached:.4g}"
    return f"{line}, so the claimed bound {gain:.4g} is false" if gain is not None and reached > gain else line


def _show_assumptions(assumes: dict[str, Any]) -> None:
    print("assumptions")
    for key, value in assumes.items():
        unbounded = key in _UNBOUNDED and value in (None, 0)
        text = _UNBOUNDED[key] if unbounded else "none" if value is None else value
        say(f"  {_ASSUMPTIONS.get(key, key):22} {text}")
