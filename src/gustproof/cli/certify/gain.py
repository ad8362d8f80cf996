"""The command `gustproof certify gain`: a proved gain of a design's loop over an envelope."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.certify.printed import leave_with, show_certificate
from gustproof.cli.laws import find_law_vehicle
from gustproof.cli.options import AsJson, Force, check_output, complete, working

if TYPE_CHECKING:
    from gustproof.design.designs import Design
    from gustproof.law.form import Law
    from gustproof.robust.gain.certificate import Certificate
    from gustproof.robust.gain.parts import Delay
    from gustproof.robust.lti.state_space import LinearSystem
    from gustproof.robust.uncertain.interconnection import Interconnection

ANGLE = typer.Option("--angle-rad", help="Envelope: largest roll and pitch [rad], below pi/2.")
RATE = typer.Option("--rate-rad-s", help="Envelope: largest rates p, q, r [rad/s].")
ExactRho = Annotated[
    bool, typer.Option("--exact-rho", help="Controller with the airframe's A(rho) and exact knowledge of rho.")
]
Slow = Annotated[bool, typer.Option("--slow", help="Bound the speeds of roll and pitch by the envelope's rates.")]
Leak = Annotated[float | None, typer.Option(help="Leak of the plant's Euler kinematics [1/s] [default: the design's].")]
Late = Annotated[
    float | None, typer.Option("--delay-ms", help="The command is late by a constant time from 0 to this [ms].")
]
Saturated = Annotated[
    float | None,
    typer.Option(help="Torque is limited, and commands are at most so many times the limit; inf for any."),
]


class GainOptions(NamedTuple):
    """Loop of a gain, as on a command line."""

    angle: float
    """[rad] largest roll and pitch."""
    rate: float
    """[rad/s] largest body rates."""
    exact_rho: bool = False
    """True for a controller that is scheduled with exact rho."""
    slow: bool = False
    """True if the speeds of roll and pitch are bounded."""
    leak: float | None = None
    """[1/s] leak of the plant; `None` for the design's."""
    delay_ms: float | None = None
    """[ms] largest delay of the command; `None` for none."""
    saturation: float | None = None
    """[-] largest command over the limit of torque; `None` for no limit."""


def gain(
    name: Annotated[
        str,
        typer.Argument(
            help="A shipped design or the law made from one, a design .toml, or a scheduled law .json.",
            autocompletion=complete("design"),
            show_default=False,
        ),
    ],
    angle: Annotated[float, ANGLE],
    rate: Annotated[float, RATE],
    level: Annotated[float | None, typer.Option(help="Gain to prove [default: the least provable one].")] = None,
    exact_rho: ExactRho = False,
    slow: Slow = False,
    leak: Leak = None,
    delay_ms: Late = None,
    saturation: Saturated = None,
    vehicle: Annotated[
        str | None,
        typer.Option(help="Vehicle [default: the design's, or the law's].", autocompletion=complete("vehicle")),
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the certificate here (.json).")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Prove the L2 gain of a design's loop, for every motion within an envelope, however fast.

    The gain is from weighted inputs (moment, gyro noise) to weighted outputs (attitude error, command) of the
    continuous loop. A solver proposes evidence; what is called proven was checked in exact arithmetic. A simulation
    shows how tight it is. `gustproof guide prove` explains the options. Exit status: 0 proven, 1 not.

        gustproof certify gain hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 -o certificate.json
        gustproof certify gain hinf-d1 --angle-rad 0.3 --rate-rad-s 0.5 --exact-rho --leak 0.05
        gustproof certify gain hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 --delay-ms 8 --saturation 1.5
    """
    options = GainOptions(angle, rate, exact_rho, slow, leak, delay_ms, saturation)
    check_envelope(options)
    check_output(output, ".json", "a certificate")
    with working(f"proving a gain of {name}", quiet=as_json):
        vehicle, certificate = _certify(name, vehicle, level, options)
    if output is not None and certificate.proven:
        certificate.save(output)
    show_certificate(name, vehicle, certificate, output, as_json=as_json)
    leave_with(is_whole=certificate.is_whole)


def check_envelope(options: GainOptions) -> None:
    """Refuse an angle that is none, and say so of degrees.

    Raises
    ------
    ConfigError
        If the angle is pi/2 or more, and may be in degrees.
    """
    angle = options.angle
    if math.pi / 2.0 <= angle <= 90.0:
        raise ConfigError(
            f"--angle-rad: the angle is {angle} rad, must be below pi/2; {angle:g} deg is {math.radians(angle):.2g}"
        )


def _certify(name: str, vehicle: str | None, level: float | None, options: GainOptions) -> "tuple[str, Certificate]":
    from gustproof.prove.attitude_gain import certify_gain

    vehicle, design, problem, controller = name_loop(name, vehicle, options.leak)
    delay = parse_delay(options.delay_ms)
    try:
        return vehicle, certify_gain(
            problem,
            controller,
            angle=options.angle,
            rate=options.rate,
            scheduled=options.exact_rho or design.scheduled,
            rate_bounded=options.slow,
            level=level,
            delay=delay,
            saturation=options.saturation,
        )
    except ValueError as error:
        raise ConfigError(f"design {design.name}: {error}") from None


def parse_delay(delay_ms: float | None) -> "Delay | None":
    """Return the delay of the command on the command line.

    Raises
    ------
    ConfigError
        If it is none.
    """
    from gustproof.robust.gain.parts import Delay

    if delay_ms is None:
        return None
    try:
        return Delay(largest=1e-3 * delay_ms)
    except ValueError as error:
        raise ConfigError(f"--delay-ms: {error}") from None


def name_loop(
    name: str, vehicle: str | None, leak: float | None
) -> "tuple[str, Design, Interconnection, LinearSystem | Law]":
    """Return vehicle, design, its problem, with another leak if given, and its controller, or a scheduled law.

    Raises
    ------
    ConfigError
        If there is no such design, or no gain of it.
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.design.derive import derive
    from gustproof.design.designs import design_problem

    design, law = _scheduled_law(name) if name.endswith(".json") else (_find_design(name), None)
    vehicle = vehicle or design.vehicle if law is None else find_law_vehicle(name, vehicle)
    airframe = load_vehicle(vehicle)
    if leak is not None and not 0.0 < leak < math.inf:
        raise ConfigError(
            f"--leak: is {leak}, must be positive: without leak the attitude integrates and no gain is finite"
        )
    problem = design_problem(design if leak is None else replace(design, leak=leak), airframe)
    return vehicle, design, problem, derive(design, airframe)[1].result.lti if law is None else law


def _find_design(name: str) -> "Design":
    """Return the design of that name, or the design of the shipped law of that name."""
    from gustproof.design.designs import list_designs, load_design
    from gustproof.law.form import list_laws

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
    from gustproof.design.designs import list_designs, load_design
    from gustproof.law.form import load_law
    from gustproof.law.schedule import sampled_controller

    law = load_law(name)
    design = law.provenance.design.split(":")[0]
    try:
        sampled_controller(law)
        if design not in list_designs():
            raise ValueError(f"law '{law.name}' was made from no shipped design, and a gain needs the weights of one")
    except ValueError as error:
        raise ConfigError(f"{name}: {error}; give the design") from None
    return load_design(design), law
