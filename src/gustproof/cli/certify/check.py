"""The command `gustproof certify check`: a certificate in exact arithmetic."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.certify.gain import (
    ANGLE,
    RATE,
    ExactRho,
    GainOptions,
    Late,
    Leak,
    Saturated,
    Slow,
    check_envelope,
    name_loop,
    parse_delay,
)
from gustproof.cli.certify.printed import leave_with, show_assumptions
from gustproof.cli.failures import say
from gustproof.cli.options import AsJson, complete, print_json, refuse_given, working

if TYPE_CHECKING:
    from collections.abc import Callable

    from gustproof.checker.evidence import CheckResult
    from gustproof.checker.rational import RationalMatrix
    from gustproof.robust.gain.parts import Part
    from gustproof.robust.uncertain.uncertain_system import Uncertain

_LOOP = ("angle", "rate", "exact_rho", "slow", "leak", "delay_ms", "saturation")
"""Options of a gain's loop."""


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


def check(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(help="A certificate (.json).", show_default=False)],
    law: Annotated[
        str | None,
        typer.Option(help="Law of a box: a name or a .json file.", autocompletion=complete("law")),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(help="Vehicle: a name or a .toml file.", autocompletion=complete("vehicle")),
    ] = None,
    air: Annotated[
        str | None,
        typer.Option(help="Scenario of an air's box: a name or a .toml file.", autocompletion=complete("scenario")),
    ] = None,
    design: Annotated[
        str | None,
        typer.Option(
            help="Design of a gain, or a scheduled law .json: derive its loop again.",
            autocompletion=complete("design"),
        ),
    ] = None,
    angle: Annotated[float | None, ANGLE] = None,
    rate: Annotated[float | None, RATE] = None,
    exact_rho: ExactRho = False,
    slow: Slow = False,
    leak: Leak = None,
    delay_ms: Late = None,
    saturation: Saturated = None,
    as_json: AsJson = False,
) -> None:
    """Check a certificate in exact arithmetic, without a solver.

    A box is derived again from the files of law and vehicle, and of its air. With --design, its envelope and the
    options that it was proved with, so is the loop of a gain; the lower bound is flown again. What a check does not
    use is refused. Exit status: 0 proven, 1 not proven or refused, 2 bad input.

        gustproof certify check certificate.json
        gustproof certify check certificate.json --design hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5
        gustproof certify check flight.json --law flagship --vehicle paper
        gustproof certify check chance.json --law flagship --vehicle paper --air paper-turbulence
    """
    derived = None
    if design is None:
        refuse_given(context, _LOOP, "without --design no loop of a gain is derived")
    else:
        refuse_given(context, ("law", "air"), "a gain takes its --design, and no files of a flight")
    with working(f"checking {file}", quiet=as_json):
        if design is not None:
            envelope = _parse_envelope(angle, rate)
            derived = _derive_loop(design, vehicle, GainOptions(*envelope, exact_rho, slow, leak, delay_ms, saturation))
        is_whole = _check(file, law, None if design else vehicle, air, derived, as_json=as_json)
    leave_with(is_whole=is_whole)


def _parse_envelope(angle: float | None, rate: float | None) -> tuple[float, float]:
    """Return largest angle [rad] and rate [rad/s]."""
    if angle is None or rate is None:
        missing = "--angle-rad" if angle is None else "--rate-rad-s"
        raise ConfigError(f"{missing} is missing: --design needs the envelope, largest angle and largest rate")
    return angle, rate


def _derive_loop(name: str, vehicle: str | None, options: GainOptions) -> "_Loop":
    """Return the loop that a certificate of a design or of a scheduled law is about."""
    from gustproof.airframe.rotational import Envelope
    from gustproof.prove.attitude_gain import attitude_loop, command_parts, envelope_speeds, law_rounding

    check_envelope(options)
    angle, rate, saturation = options.angle, options.rate, options.saturation
    _, design, problem, controller = name_loop(name, vehicle, options.leak)
    delay, scheduled = parse_delay(options.delay_ms), options.exact_rho or design.scheduled
    try:
        envelope = Envelope(angle=angle, rate=rate)
        loop = attitude_loop(problem, controller, envelope, scheduled=scheduled, delay=delay, saturation=saturation)
        radius = law_rounding(problem, controller, envelope, loop, delay=delay, saturation=saturation)
        kept = design.leak if options.leak is None else options.leak
        speeds = envelope_speeds(angle, rate, leak=kept) if options.slow else None
        return _Loop(loop, speeds, command_parts(delay, saturation), radius)
    except ValueError as error:
        raise ConfigError(f"design {design.name}: {error}") from None


def _check(
    path: Path,
    law: str | None,
    vehicle: str | None,
    air: str | None,
    derived: "_Loop | None",
    *,
    as_json: bool,
) -> bool:
    """Print the verdict on a certificate, and return whether all of it is proved.

    That of a gain is about the `derived` loop, if given, which flies again.
    """
    from firmware_model.config.files import parse_json, read_text, tell_kind
    from firmware_model.config.scenario import scenario_path
    from firmware_model.config.vehicle import vehicle_path
    from gustproof.checker.evidence import FORMAT, check_certificate
    from gustproof.checker.flight_box import PROVEN, name_verdict
    from gustproof.law.form import law_path
    from gustproof.robust.gain.lft_gain import derived_loop, lower_bound

    if path.is_dir():
        raise ConfigError(f"{path}: not a certificate{tell_kind(path)}")
    try:
        text = read_text(path)
        claimed = parse_json(text)
        law_text = _read_given(law, law_path)
        vehicle_text = _read_given(vehicle, vehicle_path)
        air_text = _read_given(air, scenario_path)
    except ValueError as error:
        raise ConfigError(f"{path}: not a certificate, which is JSON{tell_kind(path) or f': {error}'}") from None
    if not isinstance(claimed, dict) or claimed.get("format") != FORMAT:
        raise ConfigError(f"{path}: not a certificate: its format must be '{FORMAT}'{tell_kind(path)}")
    _refuse_misuse(path, claimed, {"--law": law, "--vehicle": vehicle, "--air": air}, is_of_design=derived is not None)
    loop = None if derived is None else derived_loop(*derived)
    verdict = check_certificate(text, law=law_text, vehicle=vehicle_text, scenario=air_text, loop=loop)
    if verdict.accepted and derived is not None:
        verdict = _weigh(verdict, lower_bound(*derived[:3]))
    _show_verdict(verdict, as_json=as_json)
    return verdict.accepted and name_verdict(verdict.figures, verdict.assumes) == PROVEN


def _refuse_misuse(path: Path, claimed: "dict[str, Any]", given: dict[str, str | None], *, is_of_design: bool) -> None:
    """Refuse options that a certificate of this kind does not use, or lacks: the command is wrong, not the proof."""
    from gustproof.checker.flight_box import KIND
    from gustproof.checker.gaussian_box import KIND as CHANCE

    evidence = claimed.get("evidence")
    kind = str(evidence.get("kind")) if isinstance(evidence, dict) else ""
    used = {KIND: ("--law", "--vehicle"), CHANCE: ("--law", "--vehicle", "--air")}.get(kind, ())
    about = {KIND: "a flight", CHANCE: "a flight's chance"}.get(kind, "a gain")
    if used and is_of_design:
        raise ConfigError(f"{path}: is about {about}: leave out --design")
    for option, name in given.items():
        if (name is None) == (option in used):
            raise ConfigError(f"{path}: is about {about}: {'give' if name is None else 'leave out'} {option}")


def _read_given(name: str | None, find: "Callable[[str], Path]") -> str | None:
    """Return the text of a file that `find` finds by its name; `None` without one."""
    from firmware_model.config.files import read_text

    return None if name is None else read_text(find(name))


def _weigh(verdict: "CheckResult", reached: float) -> "CheckResult":
    """Return the verdict on a gain with what a simulation `reached`; one that exceeds the gain refutes it."""
    from gustproof.checker.directed_rounding import print_down, print_up

    gain = verdict.figures["gain"]
    if reached > gain:
        reason = f"a simulation reached {print_down(reached)}, above the gain {print_up(gain)}"
        return replace(verdict, accepted=False, reason=reason, figures={})
    return replace(verdict, figures={**verdict.figures, "lower_bound": reached})


def _show_verdict(verdict: "CheckResult", *, as_json: bool) -> None:
    from gustproof.checker.directed_rounding import print_down
    from gustproof.checker.flight_box import PROVEN, name_verdict
    from gustproof.robust.shown import shorten_statement

    named = name_verdict(verdict.figures, verdict.assumes) if verdict.accepted else "refused"
    if as_json:
        made = {"assumes": verdict.assumes} if verdict.accepted else {}
        print_json({"proven": named == PROVEN, "reason": verdict.reason, **verdict.figures, **made})
        return
    say(f"{named}: {shorten_statement(verdict.reason)}")
    if verdict.accepted:
        if "lower_bound" in verdict.figures:
            print(f"a simulation of the derived loop reached {print_down(verdict.figures['lower_bound'], 4)}")
        show_assumptions(verdict.assumes)
