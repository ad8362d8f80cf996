"""The command `gustproof export`: a law for other tools."""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.laws import LAW_HELP, find_law, is_parameter_file
from gustproof.cli.options import (
    AsJson,
    Force,
    check_folder_output,
    check_output,
    complete,
    in_range,
    print_json,
    working,
)

if TYPE_CHECKING:
    from firmware_model.config.vehicle import Vehicle
    from gustproof.law.form import Law

_FORMS = ".c for C code and a header, .json a law file, .mat for MATLAB, none for a folder of tables"


def export(
    law: Annotated[str, typer.Argument(help=LAW_HELP, autocompletion=complete("law"))],
    output: Annotated[
        list[Path] | None,
        typer.Option("-o", "--output", help=f"Write it here, once or more often: {_FORMS}.", show_default=False),
    ] = None,
    px4: Annotated[Path | None, typer.Option("--px4", help="Write a module for PX4 to this new folder.")] = None,
    ardupilot: Annotated[
        Path | None, typer.Option("--ardupilot", help="Write a custom controller for ArduCopter to this new folder.")
    ] = None,
    crazyflie: Annotated[
        Path | None, typer.Option("--crazyflie", help="Write an app for the Crazyflie's firmware to this new folder.")
    ] = None,
    attitude: Annotated[
        str | None,
        typer.Option(
            help="Attitude of the law in C: own, or autopilot, its estimate [default: own in a .c file, the "
            "autopilot's in folders for one]."
        ),
    ] = None,
    rate: Annotated[
        int | None,
        typer.Option(
            callback=in_range(10, 2000),
            help="Resample the law to this rate [Hz], if its loop stays good [default: the law's; 250 for PX4 and the "
            "Crazyflie, 400 for ArduCopter].",
        ),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle of the loop and its rotors: a shipped one or a .toml file [default: the law's own]."
        ),
    ] = None,
    float32: Annotated[
        bool, typer.Option("--float32", help="C code: single precision, with a proved bound of its rounding.")
    ] = False,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Write even a law that is unstable on the vehicle; its README says so.")
    ] = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Export a law as C code with the same bits, into an autopilot, as a MATLAB file or as tables, or import one.

    gustproof export hinf-scheduled -o law.c

    gustproof export flagship --px4 my-law

    gustproof export flagship --rate 400 -o law.c -o flagship-400hz.json

    gustproof export mine.mat -o mine.json && gustproof fly paper-turbulence --law mine.json
    """
    folders = {name: path for name, path in (("px4", px4), ("ardupilot", ardupilot), ("crazyflie", crazyflie)) if path}
    wanted = output or []
    _check_outputs(wanted, list(folders.values()))
    _check_attitude(attitude)
    code = bool(folders) or _holds_c(wanted)
    _check_options(code, rate, _find_vehicle(law, vehicle), attitude, checked=float32 or bool(folders))
    read = _read_law(law, vehicle, rate)
    with working(f"exporting {read.name}", quiet=as_json):
        report = [
            _export_folder(read, name, path, attitude, rate, vehicle, float32, anyway) for name, path in folders.items()
        ]
        if wanted:
            report.append(_export_files(read, wanted, attitude, rate, vehicle, float32, anyway))
    _print_exports(report, as_json=as_json)


def _holds_c(files: list[Path]) -> bool:
    return any(path.suffix == ".c" for path in files)


def _export_files(
    law: "Law",
    files: list[Path],
    attitude: str | None,
    rate: int | None,
    vehicle: str | None,
    float32: bool,
    anyway: bool,
) -> dict[str, Any]:
    law, report = _prepare(law, rate, vehicle, in_c=_holds_c(files), anyway=anyway)
    report = {"law": law.name, "rate_hz": 1.0 / law.dt, "files": [str(path) for path in files], **report}
    for path in files:
        if path.suffix == ".c":
            report |= _save_c(law, path, attitude or "own", float32=float32, vehicle=vehicle)
        else:
            _save_numbers(law, path)
    return report


def _print_exports(report: list[dict[str, Any]], *, as_json: bool) -> None:
    if as_json:
        print_json(report[0] if len(report) == 1 else report)
        return
    for each in report:
        _print_export(each)


def _print_export(report: dict[str, Any]) -> None:
    margins = report.get("margins", {})
    unknown = (
        "unstable" if "stable" in report or any(margins.values()) else "not checked, the loop is the autopilot's own"
    )
    for hz, figures in margins.items():
        print(f"{hz} Hz: {_describe_margins(figures) if figures else unknown}")
    if "rounding" in report:
        print(report["rounding"]["statement"])
    for file in report["files"]:
        header = f" and {Path(file).with_suffix('.h').name}" if file.endswith(".c") else ""
        read_on = f" for vehicle '{report['vehicle']}', see its README.md" if "vehicle" in report else ""
        print(f"law '{report['law']}' in {file}{header}{read_on}")
    if "verdict" in report:
        print(report["verdict"])


def _save_numbers(law: "Law", path: Path) -> None:
    from gustproof.law.write.matrices import save_csv, save_mat

    saves: dict[str, Callable[[Path], object]] = {
        ".json": law.save,
        ".mat": partial(save_mat, law),
        "": partial(save_csv, law),
    }
    saves[path.suffix](path)


def _export_folder(
    law: "Law",
    name: str,
    path: Path,
    attitude: str | None,
    rate: int | None,
    vehicle: str | None,
    float32: bool,
    anyway: bool,
) -> dict[str, Any]:
    """Write a folder for an autopilot; by default with the autopilot's attitude, at its own rate."""
    from firmware_model.config.whole_file import write_folder
    from gustproof.law.write.c import AttitudeSource
    from gustproof.law.write.firmware.folders import RATES, Firmware, firmware_folder

    firmware = Firmware(name)
    margins = {}
    wanted = rate or RATES[firmware]
    if abs(wanted * law.dt - 1.0) > 1e-9:
        law, margins["margins"] = _resample(law, wanted, vehicle, anyway=anyway)
    source = attitude or ("autopilot" if law.is_scheduled else "own")
    body = _load_vehicle(law, vehicle)
    loop = _judge_loop(law, body, anyway=anyway)
    try:
        files = firmware_folder(
            firmware, law, body, AttitudeSource(source), path.name, verdict=loop.get("verdict", ""), single=float32
        )
    except ValueError as error:
        raise ConfigError(str(error)) from None
    write_folder(path, files)
    report = {"law": law.name, "rate_hz": 1.0 / law.dt, "files": [str(path)], **margins}
    return {**report, **loop, "autopilot": name, "vehicle": body.name, "attitude": source}


def _prepare(
    law: "Law", rate: int | None, vehicle: str | None, *, in_c: bool, anyway: bool
) -> "tuple[Law, dict[str, Any]]":
    """Return the law at the rate that is asked for, with margins, and the verdict on C code for a named vehicle."""
    report: dict[str, Any] = {}
    if rate is not None:
        law, report["margins"] = _resample(law, rate, vehicle, anyway=anyway)
    if in_c and vehicle is not None:
        report |= _judge_loop(law, _load_vehicle(law, vehicle), anyway=anyway)
    return law, report


def _load_vehicle(law: "Law", vehicle: str | None) -> "Vehicle":
    """Return the vehicle that is named, or that of the law."""
    from firmware_model.config.vehicle import load_vehicle

    if vehicle is not None:
        return load_vehicle(vehicle)
    if (shipped := law.provenance.shipped_vehicle) is None:
        raise ConfigError(
            f"law '{law.name}' is for vehicle '{law.provenance.vehicle}', which is not shipped: give --vehicle FILE"
        )
    return load_vehicle(shipped)


def _judge_loop(law: "Law", vehicle: "Vehicle", *, anyway: bool) -> dict[str, Any]:
    """Return the verdict on the loop at hover at the law's rate, and its margins; refuse an unstable one.

    Raises
    ------
    ConfigError
        If the loop is unstable, but for `anyway`.
    """
    from gustproof.law.form import Output
    from gustproof.studies.rate.law_margins import hover_margins, hover_scenario

    if law.output is not Output.TORQUE:
        return {}
    scenario = hover_scenario(vehicle, round(1.0 / law.dt))
    found = hover_margins(law, vehicle, scenario)
    where = (
        f"on vehicle '{vehicle.name}' at {1.0 / law.dt:g} Hz, {1e3 * scenario.delay_samples * scenario.dt:g} ms late"
    )
    if found is not None:
        figures = asdict(found)
        return {"stable": True, "verdict": f"At hover {where}: {_describe_margins(figures)}.", "loop": figures}
    line = f"law '{law.name}' is unstable {where}, by the linear model at hover"
    if not anyway:
        raise ConfigError(f"{line}; --anyway writes it all the same")
    return {"stable": False, "verdict": f"UNSTABLE: {line}. Do not fly it.", "loop": None}


def _check_options(in_c: bool, rate: int | None, vehicle: str | None, attitude: str | None, *, checked: bool) -> None:
    """Refuse options without those that they belong to."""
    if not in_c and (checked or attitude):
        raise ConfigError("--float32 and --attitude belong to a .c file and the folders for autopilots")
    if vehicle is not None and rate is None and not checked:
        raise ConfigError(
            "--vehicle: belongs to --rate and --float32, whose loops are checked on it, and to autopilots"
        )


def _read_law(law: str, vehicle: str | None, rate: int | None) -> "Law":
    """Return the law; an autopilot's loops on the vehicle, `paper` if none is given, at `rate` [Hz]."""
    from firmware_model.config.vehicle import load_vehicle

    return find_law(law, load_vehicle(vehicle or "paper"), rate)


def _find_vehicle(law: str, vehicle: str | None) -> str | None:
    """Return the vehicle that a loop must be checked on; an autopilot's loops need one themselves."""
    return None if is_parameter_file(law) else vehicle


def _check_attitude(attitude: str | None) -> None:
    from gustproof.law.write.c import AttitudeSource

    sources = [source.value for source in AttitudeSource]
    if attitude not in (None, *sources):
        raise ConfigError(f"--attitude: is '{attitude}', must be one of {', '.join(sources)}")


def _save_c(law: "Law", path: Path, attitude: str, *, float32: bool, vehicle: str | None) -> dict[str, Any]:
    """Write the law as C code; return the cost of a step and, in single precision, what is proved of its rounding."""
    from gustproof.law.write.c import AttitudeSource, save_c
    from gustproof.law.write.operations import INSTRUCTIONS

    report: dict[str, Any] = {}
    if float32:
        own = attitude == AttitudeSource.OWN.value
        report["rounding"] = (
            _bound_rounding(law, vehicle)
            if own
            else {"proven": False, "statement": "No bound of the rounding is proved with the autopilot's attitude."}
        )
    notes = [report["rounding"]["statement"]] if float32 else []
    try:
        unit = save_c(law, path, AttitudeSource(attitude), single=float32, notes=notes)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return {"operations": unit.operations, "instructions": INSTRUCTIONS * unit.operations, **report}


def _bound_rounding(law: "Law", vehicle: str | None) -> dict[str, Any]:
    from gustproof.prove.rounding import certify_rounding

    if (named := vehicle or law.provenance.shipped_vehicle) is None:
        return {"proven": False, "statement": "No bound of the rounding is proved without --vehicle."}
    try:
        return certify_rounding(law, named).to_dict()
    except ValueError as error:
        return {"proven": False, "statement": f"No bound of the rounding is proved: {error}."}


def _resample(law: "Law", rate: int, vehicle: str | None, *, anyway: bool) -> "tuple[Law, dict[str, Any]]":
    """Return the law at another rate [Hz], and the margins at both rates, `None` if unknown."""
    from gustproof.errors import DesignError
    from gustproof.studies.rate.law_margins import resample_at_hover

    try:
        found = resample_at_hover(law, rate, _load_vehicle(law, vehicle), anyway=anyway)
    except ValueError as error:
        raise ConfigError(f"--rate: {error}") from None
    except DesignError as error:  # also at an autopilot's own rate, where no --rate is given
        raise ConfigError(f"{error}{'' if anyway else '; --anyway writes it all the same'}") from None
    margins = ((law, found.before), (found.law, found.after))
    return found.law, {f"{1.0 / each.dt:g}": None if figures is None else asdict(figures) for each, figures in margins}


def _describe_margins(figures: dict[str, Any]) -> str:
    return (
        f"Ms {figures['Ms']:.2f}, phase {figures['phase_margin_deg']:.0f} deg, gain {figures['gain_margin']:.1f}, "
        f"delay {1e3 * figures['delay_margin']:.0f} ms"
    )


def _check_outputs(files: list[Path], folders: list[Path]) -> None:
    """Refuse what has no form by its suffix, the same twice, and what exists."""
    if not files and not folders:
        raise ConfigError("nothing to write: give -o FILE, --px4, --ardupilot or --crazyflie")
    written = [*files, *folders, *(path.with_suffix(".h") for path in files if path.suffix == ".c")]
    if len({path.absolute() for path in written}) < len(written):
        raise ConfigError("two outputs have the same name")
    _check_suffixes(files, folders)
    for path in written:
        if path.suffix:
            check_output(path, path.suffix, "this file")
        else:
            check_folder_output(path)


def _check_suffixes(files: list[Path], folders: list[Path]) -> None:
    for path in files:
        if path.suffix not in (".c", ".json", ".mat", ""):
            raise ConfigError(f"{path}: its suffix says its form: {_FORMS}")
    for path in folders:
        if path.suffix:
            raise ConfigError(f"{path}: a folder has no suffix")
