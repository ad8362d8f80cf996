"""The command `gustproof certify air`: the box of a law in a scenario's turbulence."""

from pathlib import Path
from typing import Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.certify.box import LawName, LawVehicle
from gustproof.cli.certify.printed import show_assumptions, show_certificate
from gustproof.cli.failures import say
from gustproof.cli.laws import find_law_vehicle
from gustproof.cli.options import AsJson, Force, check_output, complete, print_json, working


def air(
    law: LawName,
    scenario: Annotated[
        str,
        typer.Argument(
            help="Scenario of the turbulence, a name or a .toml file.",
            autocompletion=complete("scenario"),
            show_default=False,
        ),
    ],
    risk: Annotated[float, typer.Option(help="Probability that the true attitude leaves the box.")] = 1e-3,
    vehicle: LawVehicle = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the certificate here (.json).")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Prove the box that the true attitude leaves in a scenario's turbulence with a small risk.

    The turbulence and the gyro noise last as long as the scenario. The linear part is Gaussian, with tails summed over
    all samples and axes; the rest is bounded. It is proved of a strapdown law of torque. Of others a linear Gaussian
    model predicts it, and the output says so. Exit status: 0 proven or predicted, 2 bad input.

        gustproof certify air flagship paper-turbulence --risk 1e-3 -o chance.json
    """
    from gustproof.prove.air_box import certify_chance

    check_output(output, ".json", "a certificate")
    vehicle = find_law_vehicle(law, vehicle)
    with working(f"proving a box for {law}", quiet=as_json):
        try:
            found = certify_chance(law, vehicle, scenario, risk)
            reason = found.statement
        except ValueError as error:
            found, reason = None, str(error)
    if found is None or found.truth_deg is None:
        _predict(law, vehicle, scenario, risk, reason, as_json=as_json)
        return
    if output is not None:
        found.save(output)
    if as_json:
        figures: dict[str, Any] = {"attitude_deg": found.truth_deg, "estimate_deg": found.estimate_deg, "risk": risk}
        figures |= {"horizon_s": found.assumes["horizon_s"], "air": scenario, "vehicle": vehicle}
        print_json({"proven": True, **figures, "assumes": found.assumes, "statement": found.statement})
        return
    show_certificate(law, vehicle, found, output, as_json=False)


def _predict(law: str, vehicle: str, scenario: str, risk: float, reason: str, *, as_json: bool) -> None:
    """Print the box that the linear Gaussian model predicts, and the reason why none is proved."""
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.airframe.chance import attitude_box
    from gustproof.checker.directed_rounding import list_up, print_down
    from gustproof.law.form import load_law

    try:
        found = attitude_box(load_law(law), load_vehicle(vehicle), load_scenario(scenario), risk)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    if as_json:
        figures = {"attitude_deg": found.attitude_deg, "risk": found.risk, "horizon_s": found.horizon_s}
        figures |= {"air": scenario, "vehicle": vehicle}
        print_json({"proven": False, **figures, "assumes": found.assumes, "statement": reason})
        return
    claim = f"|phi|, |theta|, |psi| stay below {list_up(found.attitude_deg)} deg for {print_down(found.horizon_s)} s"
    probability = print_down(1.0 - found.risk, 9)
    say(f"{law} on {vehicle}: predicted, not proven: {claim} of {scenario} with probability {probability} or more")
    say(f"no proof: {reason}")
    show_assumptions(found.assumes)
