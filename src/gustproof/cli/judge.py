"""The command `gustproof judge`: a user's gains on his vehicle."""

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus
from gustproof.cli.laws import is_log, is_parameter_file, logged_parameters, read_gains
from gustproof.cli.options import (
    SEED,
    AsJson,
    Force,
    VehicleName,
    check_output,
    is_given,
    parse_positive_vector,
    print_again,
    print_json,
    print_next,
    progress,
)

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.uncertainty import VehicleSet
    from firmware_model.config.vehicle import Vehicle
    from gustproof.design.autopilot_gains import AutopilotTuning
    from gustproof.design.tune import Tuning
    from gustproof.law.form import Law
    from gustproof.logs.identify.shown_vehicle import ShownVehicle
    from gustproof.logs.read.flight_log import FlightLog
    from gustproof.studies.rate.improvement import Improvement
    from gustproof.studies.rate.judge import Judgement


def judge(
    context: typer.Context,
    gains: Annotated[
        str,
        typer.Argument(
            help="Parameters of PX4 or ArduPilot (.params, .param), a flight log (.ulg, .bin, .log) that has them, px4 "
            "or ardupilot for their defaults, or a law."
        ),
    ],
    vehicle: VehicleName = "paper",
    over: Annotated[
        str | None, typer.Option(help="Load the file over these parameters, of a log or a file, as on the vehicle.")
    ] = None,
    air: Annotated[str, typer.Option(help="Scenario that gives turbulence and delay.")] = "paper-turbulence",
    moment: Annotated[
        str | None,
        typer.Option(help="Budget of the worst gust, L,M,N [N m] [default: 3 times the rms moment of the air]."),
    ] = None,
    better: Annotated[
        Path | None,
        typer.Option(help="Write better gains here: of the autopilot (.params) or, for a law, a flagship (.json)."),
    ] = None,
    seed: Annotated[int, SEED] = 1,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write a page here (.html).")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Judge gains on a vehicle and its spreads: sound, fragile or unstable, with the evidence.

    Margins nominal and over the spreads of inertia and lag in the vehicle file, proved where the law permits. Predicted
    error and slew in the air, beside the least possible at that price. The worst gust found within a moment budget. A
    proved bound of the attitude, and the nearest case that fails, flown. Then advice from the loop itself: what each
    filter and gain costs, what another value would allow, and better gains; for a law those if --better is given.
    Those have at most twice the torque slew. Their title tells the cost.

    Sound means stable over the spreads, with Ms at most 2 for the nominal vehicle and 2.5 over the spreads. It also
    means a delay margin of a sample and 5 ms, and no gust found that costs the attitude. Exit status: 0 sound, 1
    fragile or unstable, 2 bad input.

        gustproof judge my.params --vehicle my-quad.toml -o my.html

        gustproof judge flight.ulg --vehicle my-quad.toml --better my-better.params

        gustproof judge flagship --json
    """
    from firmware_model.config.files import PARAMETER_SUFFIXES
    from gustproof.show.report.judgement import NONE_BETTER
    from gustproof.studies.rate.advice import autopilot_kind
    from gustproof.studies.rate.judge import Verdict

    check_output(output, ".html", "a page")
    budget = None if moment is None else parse_positive_vector("--moment", moment)
    log, vehicles, script, found_in = _choose_vehicle(context, over or gains, quiet=as_json)
    law, step, remarks = read_gains(gains, vehicles.nominal, over, log)
    remarks = (*found_in, *remarks)
    is_autopilot = autopilot_kind(law) is not None
    check_output(better, *((PARAMETER_SUFFIXES, "a parameter file") if is_autopilot else (".json", "a law")))
    _tell_default(context, log, is_autopilot=is_autopilot)
    asked: dict[str, Any] = {"moment": budget, "thrust_step": step, "seed": seed}
    search = is_autopilot or better is not None
    found, tuned, improved = _judge_both(law, vehicles, script, search=search, quiet=as_json, **asked)
    remarks = (*_contradict(found, log, over), *remarks, *_predict_flight(found, log, over))
    in_vain = (NONE_BETTER,) * (search and tuned is None)
    written = [*_save(tuned, vehicles.nominal, better), *filter(None, [output])]
    _tell(found, improved, (remarks, in_vain), output, as_json=as_json)
    if not as_json:
        print("".join(f"{path} is written\n" for path in written), end="")
        _print_next(context, found, tuned, vehicles.nominal, better)
    if in_vain and better:
        raise ConfigError(f"{NONE_BETTER}: {better} is not written")
    if found.verdict is not Verdict.SOUND:
        raise typer.Exit(ExitStatus.REQUIREMENT_FAILED.value)


def _print_next(
    context: typer.Context,
    found: "Judgement",
    tuned: "AutopilotTuning | Tuning | None",
    vehicle: "Vehicle",
    better: Path | None,
) -> None:
    """Print the way from a verdict to the board: better gains, a flight of the autopilot, or the law's export."""
    from gustproof.studies.rate.advice import autopilot_kind
    from gustproof.studies.rate.judge import Verdict

    kind, is_better = autopilot_kind(found.law), tuned is not None and better is not None
    named = context.params["vehicle"]
    chosen = str(better) if is_better else context.params["gains"]
    stem = Path(chosen).stem
    if not is_better and found.verdict is not Verdict.SOUND:
        if better is None and (kind is None or tuned is not None):
            print_again(context, "--better", stem + ("-better.json", "-better.params")[kind is not None])
    elif kind is None:
        print_next("export", chosen, *_export_words(found.law, vehicle, named, stem))
    elif is_parameter_file(chosen) and _flies_its_rotors(vehicle):
        print_next("fly", context.params["air"], "--autopilot", kind, "--params", chosen, "--vehicle", named)


def _export_words(law: "Law", vehicle: "Vehicle", named: str, stem: str) -> tuple[str, ...]:
    """Return how a law is exported: for the autopilot of the vehicle's log or PX4, as C where that is not possible."""
    from firmware_model.config.firmware import ardupilot_full_torque, check_measured, measured_torque
    from gustproof.law.form import Output
    from gustproof.law.write.firmware.folders import Firmware

    firmwares = [each.value for each in Firmware]
    logged = vehicle.command.autopilot if vehicle.command else ""
    firmware = logged if logged in firmwares else "px4"
    try:
        check_measured(vehicle)
        if measured_torque(firmware, vehicle) is None and firmware == "ardupilot":
            ardupilot_full_torque(vehicle)
    except ConfigError:
        return "-o", f"{stem}.c"
    to_folder = "--vehicle", named, f"--{firmware}", f"{stem}-{firmware}"
    return to_folder if law.output is Output.TORQUE else ("-o", f"{stem}.c")


def _flies_its_rotors(vehicle: "Vehicle") -> bool:
    from firmware_model.config.firmware import check_rotors

    try:
        check_rotors(vehicle)
    except ConfigError:
        return False
    return True


def _choose_vehicle(
    context: typer.Context, source: str, *, quiet: bool
) -> "tuple[FlightLog | None, VehicleSet, Scenario, tuple[str, ...]]":
    """Return the log of the gains, if it shows the vehicle, the vehicle, the air, and a remark on both."""
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.uncertainty import load_vehicle_set

    usual = load_scenario(context.params["air"])
    if is_given(context, "vehicle") or not is_log(source):
        return None, load_vehicle_set(context.params["vehicle"]), usual, ()
    log, flown = _show_vehicle(Path(source), quiet=quiet)
    own = None if is_given(context, "air") else flown.scenario()
    return log, flown.vehicles(), own or usual, (_describe_flown(flown, own),)


def _show_vehicle(path: Path, *, quiet: bool) -> "tuple[FlightLog, ShownVehicle]":
    """Return a log and the vehicle that it shows.

    Raises
    ------
    ConfigError
        If it shows none.
    """
    from gustproof.logs.identify.shown_vehicle import show_vehicle
    from gustproof.logs.read.read_log import read_log

    with progress(f"reading {path}", quiet=quiet) as shown:
        log = read_log(path)
        logged_parameters(path, log)  # refused before the work, not after it
        try:
            found = show_vehicle(log, path.stem, progress=lambda share: shown(share, f"identify {path}"))
        except ConfigError as error:
            raise ConfigError(f"{error}; or give --vehicle FILE") from None
    if found.file is None:
        raise ConfigError(f"{found.refusal}; or give --vehicle FILE")
    return log, found


def _contradict(found: "Judgement", log: "FlightLog | None", over: str | None) -> tuple[str, ...]:
    """Return the remark on gains that flew in the log but are unstable by the model; none for a file over it."""
    from gustproof.studies.logged_flight import contradiction

    return tuple(filter(None, [contradiction(log, found)])) if log is not None and over is None else ()


def _predict_flight(found: "Judgement", log: "FlightLog | None", over: str | None) -> tuple[str, ...]:
    """Return the remark on the error that the flight of a log would have had with the gains loaded over its own."""
    if over is None or not is_log(over) or not found.axes:
        return ()
    from gustproof.logs.read.read_log import read_log
    from gustproof.studies.rate.failure_case import spectral_radius
    from gustproof.studies.rate.flight_error import LEAST_HZ, flight_errors

    log = log or read_log(Path(over))
    flown, _, _ = read_gains(over, found.vehicle, log=log)
    if flown.dt != found.law.dt or spectral_radius(flown, found.vehicle, found.scenario) >= 1.0:
        return ()
    was, there = flight_errors(log, flown, [flown, found.law], found.vehicle, found.scenario) or ((), ())
    if not was:
        return ()
    told = (", ".join(f"{math.degrees(each):.3g}" for each in angles) for angles in (there, was))
    new, old = told
    return (f"in this flight: error of roll, pitch and yaw {new} deg in place of {old} deg, above {LEAST_HZ:g} Hz",)


def _describe_flown(flown: "ShownVehicle", own: "Scenario | None") -> str:
    from gustproof.studies.logged_flight import NO_MASS

    air = "in the air that it flew in" if own else "not in its own air"
    return f"on the vehicle that {flown.identification.source} shows, {air}; {NO_MASS}"


def _tell_default(context: typer.Context, log: "FlightLog | None", *, is_autopilot: bool) -> None:
    """Say on stderr that gains, which unlike a law do not tell their vehicle, are judged on the default one."""
    if is_autopilot and log is None and not is_given(context, "vehicle"):
        vehicle = context.params["vehicle"]
        print(f"gustproof: no --vehicle given: judged on '{vehicle}'", file=sys.stderr, flush=True)


def _judge_both(
    law: "Law", vehicles: "VehicleSet", scenario: "Scenario", *, search: bool, quiet: bool, **asked: Any
) -> "tuple[Judgement, AutopilotTuning | Tuning | None, Improvement | None]":
    """Return the judgement of a law, better gains if they are searched and found, and what they bring and cost.

    Raises
    ------
    ConfigError
        If the law cannot be judged on the vehicle or in the scenario.
    """
    from gustproof.studies.rate.improvement import weigh
    from gustproof.studies.rate.judge import improve, judge_law

    try:
        with progress(f"judging {law.name}", quiet=quiet) as shown:
            found = judge_law(law, vehicles, scenario, progress=shown, **asked)
            shown(0.9, "better gains")
            tuned = improve(found, vehicles) if search else None
            if tuned is None:
                return found, None, None
            weighed = weigh(found, judge_law(tuned.law, vehicles, scenario, **asked), asked["seed"])
            return found, None if weighed is None else tuned, weighed
    except (ValueError, OverflowError) as error:
        raise ConfigError(f"law '{law.name}' cannot be judged on vehicle '{vehicles.nominal.name}': {error}") from None


def _tell(
    found: "Judgement",
    improved: "Improvement | None",
    lines: tuple[tuple[str, ...], tuple[str, ...]],
    output: Path | None,
    *,
    as_json: bool,
) -> None:
    """Write the page, if one is asked for, and print the judgement; `lines` are remarks, and a search in vain."""
    from gustproof.show.report.judgement import render_judgement
    from gustproof.show.report.terminal import show

    remarks, in_vain = lines
    if output is not None:
        from gustproof.show.report.html.judgement_page import write_judgement

        write_judgement(found, improved, (*remarks, *in_vain), output)
    if as_json:
        print_json({**found.to_dict(), "remarks": remarks, "better": None if improved is None else improved.to_dict()})
        return
    show(render_judgement(found, improved))
    print("\n".join([*(f"model: {remark}" for remark in remarks), *in_vain]))


def _save(tuned: "AutopilotTuning | Tuning | None", vehicle: "Vehicle", path: Path | None) -> list[Path]:
    """Write better gains if they are found and a file is named for them; return the files written."""
    from gustproof.design.autopilot_gains import AutopilotTuning, save_tuning

    if tuned is None or path is None:
        return []
    if isinstance(tuned, AutopilotTuning):
        save_tuning(tuned, vehicle, path)
    else:
        tuned.law.save(path)
    return [path]
