"""The command `gustproof certify box`: a box that a law's flight does not leave."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.certify.printed import leave_with, show_certificate
from gustproof.cli.laws import find_law_vehicle
from gustproof.cli.options import AsJson, Force, check_output, complete, parse_positive_vector, print_next, working

if TYPE_CHECKING:
    from gustproof.prove.boundedness import FlightCertificate

LawName = Annotated[
    str,
    typer.Argument(help="A shipped law, or a law file .json.", autocompletion=complete("law"), show_default=False),
]
LawVehicle = Annotated[
    str | None,
    typer.Option(
        help="Name of a shipped vehicle, or a .toml file [default: the one that the law names].",
        autocompletion=complete("vehicle"),
    ),
]


def box(
    law: LawName,
    moment: Annotated[str, typer.Option(help="Largest moment about each axis, L,M,N [N m].")] = "0.65,0.65,0.3",
    moment_class: Annotated[
        str, typer.Option(help="The moment between two samples: held, slope (see --slope), or any function.")
    ] = "held",
    slope: Annotated[
        str | None, typer.Option(help="Largest slope of the moment within a sample, L,M,N [N m/s].")
    ] = None,
    horizon: Annotated[
        float, typer.Option(help="How long the true attitude is bounded [s]; inf bounds the law's own alone.")
    ] = 60.0,
    noise: Annotated[float, typer.Option(help="rms of the gyro's white noise in a sample [rad/s].")] = 0.0,
    risk: Annotated[
        float, typer.Option(help="Probability that the noise leaves its bounds in the horizon, or in 600 s.")
    ] = 1e-3,
    inertia_spread: Annotated[float, typer.Option(help="Every constant inertia within this share, such as 0.2.")] = 0.0,
    lag_spread: Annotated[float, typer.Option(help="Every constant actuator lag within this share.")] = 0.0,
    vehicle: LawVehicle = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the certificate here (.json).")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Prove that a law's flight stays in a box under every moment within a bound.

    The law file is taken as it is: sampled, one sample late, on the nonlinear vehicle without leak. Its own attitude,
    rates and commands stay in the box for ever. The true attitude leaves that of a strapdown law by a drift at most.
    Of a law that reads the accelerometer true roll and pitch stay in a box for ever, and heading has no bound. If only
    a part of the moment is proved, the verdict is NOT proven. Exit status: 0 proven, 1 not.

        gustproof certify box flagship --moment 0.65,0.65,0.3 --horizon 60 -o flight.json
        gustproof certify box flagship --horizon inf --noise 0.0036 --risk 1e-3
    """
    check_output(output, ".json", "a certificate")
    vehicle = find_law_vehicle(law, vehicle)
    asked: dict[str, Any] = {"noise": noise, "risk": risk, "inertia_spread": inertia_spread, "lag_spread": lag_spread}
    with working(f"proving a box for {law}", quiet=as_json):
        certificate = _certify(law, vehicle, moment, moment_class, slope, horizon, **asked)
    if output is not None and certificate.proven:
        certificate.save(output)
    show_certificate(law, vehicle, certificate, output, as_json=as_json)
    if output is not None and certificate.proven and not as_json:
        print_next("certify", "check", output, "--law", law, "--vehicle", vehicle)
    leave_with(is_whole=certificate.is_whole)


def _certify(
    law: str, vehicle: str, moment: str, moment_class: str, slope: str | None, horizon: float, **asked: float
) -> "FlightCertificate":
    from gustproof.checker.flight_box import InterSampleMoment
    from gustproof.prove.boundedness import certify_boundedness

    classes = [member.value for member in InterSampleMoment]
    if moment_class not in classes:
        raise ConfigError(f"--moment-class: is '{moment_class}', must be one of {', '.join(classes)}")
    try:
        return certify_boundedness(
            law,
            vehicle,
            moment=parse_positive_vector("--moment", moment),
            horizon=None if horizon == math.inf else horizon,
            moment_class=InterSampleMoment(moment_class),
            slope=(0.0, 0.0, 0.0) if slope is None else parse_positive_vector("--slope", slope),
            **asked,
        )
    except ValueError as error:
        raise ConfigError(str(error)) from None
