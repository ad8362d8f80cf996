"""The command `gustproof export`: a law for other tools."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError, naming
from gustproof.cli.laws import LAW_HELP, find_law, is_parameter_file
from gustproof.cli.options import AsJson, complete, print_json, working

if TYPE_CHECKING:
    from gustproof.law.form import Law


def export(
    law: Annotated[str, typer.Argument(help=LAW_HELP, autocompletion=complete("law"))],
    c: Annotated[Path | None, typer.Option("--c", help="Write C code here, and its header beside it.")] = None,
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
            help="Attitude of the law in C, its own or an estimate by the autopilot: own, autopilot "
            "[default: own with --c, the autopilot's in folders for one]."
        ),
    ] = None,
    rate: Annotated[
        int | None,
        typer.Option(
            min=10,
            max=1000,
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
    mat: Annotated[Path | None, typer.Option("--mat", help="Write a MATLAB file here.")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Write tables of numbers to this new folder.")] = None,
    as_law: Annotated[
        Path | None, typer.Option("--law", help="Write a law file (.json) that can be flown here.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Export a law as C code with the same bits, into an autopilot, as a MATLAB file or as tables, or import one.

    gustproof export hinf-scheduled --c law.c

    gustproof export flagship --px4 my-law

    gustproof export flagship --rate 400 --c law.c --law flagship-400hz.json

    gustproof export mine.mat --law mine.json && gustproof fly paper-turbulence --law mine.json
    """
    folders = {name: path for name, path in (("px4", px4), ("ardupilot", ardupilot), ("crazyflie", crazyflie)) if path}
    wanted = {path: suffix for path, suffix in ((c, ".c"), (mat, ".mat"), (csv, ""), (as_law, ".json")) if path}
    _check_outputs({**wanted, **dict.fromkeys(folders.values(), "")}, c)
    _check_attitude(attitude)
    _check_options(bool(c or folders), rate, _find_vehicle(law, vehicle), attitude, checked=float32 or bool(folders))
    read = _read_law(law, vehicle, rate)
    with working(f"exporting {read.name}", quiet=as_json):
        told = [_export_folder(read, name, path, attitude, rate, vehicle, float32) for name, path in folders.items()]
        if wanted:
            margins = {}
            if rate is not None:
                read, margins["margins"] = _resample(read, rate, vehicle)
            files = [str(path) for path in wanted]
            told.append({"law": read.name, "rate_hz": 1.0 / read.dt, "files": files, **margins})
            if c is not None:
                told[-1] |= _save_c(read, c, attitude or "own", float32=float32, vehicle=vehicle)
            _save_numbers(read, mat, csv, as_law)
    _print_exports(told, c, as_json=as_json)


def _print_exports(told: list[dict[str, Any]], c: Path | None, *, as_json: bool) -> None:
    if as_json:
        print_json(told[0] if len(told) == 1 else told)
        return
    for each in told:
        _print_export(each, c)


def _print_export(told: dict[str, Any], c: Path | None) -> None:
    for hz, figures in told.get("margins", {}).items():
        print(f"{hz} Hz: {_describe_margins(figures)}")
    if "rounding" in told:
        print(told["rounding"]["statement"])
    for file in told["files"]:
        header = f" and {c.with_suffix('.h').name}" if c and file == str(c) else ""
        read_on = f" for vehicle '{told['vehicle']}', see its README.md" if "vehicle" in told else ""
        print(f"law '{told['law']}' in {file}{header}{read_on}")


def _save_numbers(law: "Law", mat: Path | None, csv: Path | None, as_law: Path | None) -> None:
    from gustproof.law.io.matrices import save_csv, save_mat

    if mat is not None:
        with naming(mat):
            save_mat(law, mat)
    if csv is not None:
        save_csv(law, csv)
    if as_law is not None:
        law.save(as_law)


def _export_folder(
    law: "Law", name: str, path: Path, attitude: str | None, rate: int | None, vehicle: str | None, float32: bool
) -> dict[str, Any]:
    """Write a folder for an autopilot; by default with the autopilot's attitude, at its own rate."""
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.export.folders import RATES, Firmware, firmware_folder, save_folder
    from gustproof.law.io.c import Attitude

    firmware = Firmware(name)
    margins = {}
    wanted = rate or RATES[firmware]
    if abs(wanted * law.dt - 1.0) > 1e-9:
        law, margins["margins"] = _resample(law, wanted, vehicle)
    source = attitude or ("autopilot" if law.is_scheduled else "own")
    body = load_vehicle(vehicle or law.provenance.vehicle)
    try:
        files = firmware_folder(firmware, law, body, Attitude(source), path.name, single=float32)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    save_folder(files, path)
    told = {"law": law.name, "rate_hz": 1.0 / law.dt, "files": [str(path)], **margins}
    return {**told, "autopilot": name, "vehicle": body.name, "attitude": source}


def _check_options(in_c: bool, rate: int | None, vehicle: str | None, attitude: str | None, *, checked: bool) -> None:
    """Refuse options without those that they belong to."""
    if not in_c and (checked or attitude):
        raise ConfigError("--float32 and --attitude belong to --c and the folders for autopilots")
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
    from gustproof.law.io.c import Attitude

    sources = [source.value for source in Attitude]
    if attitude not in (None, *sources):
        raise ConfigError(f"--attitude: is '{attitude}', must be one of {', '.join(sources)}")


def _save_c(law: "Law", path: Path, attitude: str, *, float32: bool, vehicle: str | None) -> dict[str, Any]:
    """Write the law as C code; return the cost of a step and, in single precision, what is proved of its rounding."""
    from gustproof.law.io.c import Attitude, save_c
    from gustproof.law.io.operations import INSTRUCTIONS

    told: dict[str, Any] = {}
    if float32:
        own = attitude == Attitude.OWN.value
        told["rounding"] = (
            _bound_rounding(law, vehicle)
            if own
            else {"proven": False, "statement": "No bound of the rounding is proved with the autopilot's attitude."}
        )
    notes = [told["rounding"]["statement"]] if float32 else []
    try:
        unit = save_c(law, path, Attitude(attitude), single=float32, notes=notes)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return {"operations": unit.operations, "instructions": INSTRUCTIONS * unit.operations, **told}


def _bound_rounding(law: "Law", vehicle: str | None) -> dict[str, Any]:
    from gustproof.certify.rounding import certify_rounding

    try:
        return certify_rounding(law, vehicle or law.provenance.vehicle).to_dict()
    except ValueError as error:
        return {"proven": False, "statement": f"No bound of the rounding is proved: {error}."}


def _resample(law: "Law", rate: int, vehicle: str | None) -> "tuple[Law, dict[str, Any]]":
    """Return the law at another rate [Hz], and the margins at both rates, `None` if unknown."""
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.analysis.law_margins import resample_at_hover
    from gustproof.errors import DesignError

    try:
        found = resample_at_hover(law, rate, load_vehicle(vehicle or law.provenance.vehicle))
    except (DesignError, ValueError) as error:
        raise ConfigError(f"--rate: {error}") from None
    margins = ((law, found.before), (found.law, found.after))
    return found.law, {f"{1.0 / each.dt:g}": None if figures is None else asdict(figures) for each, figures in margins}


def _describe_margins(figures: dict[str, Any] | None) -> str:
    if figures is None:
        return "not checked, the loop is the autopilot's own"
    return (
        f"Ms {figures['Ms']:.2f}, phase {figures['phase_margin_deg']:.0f} deg, gain {figures['gain_margin']:.1f}, "
        f"delay {1e3 * figures['delay_margin']:.0f} ms"
    )


def _check_outputs(suffixes: dict[Path, str], c: Path | None) -> None:
    """Refuse files with a wrong suffix, and files that exist."""
    if not suffixes:
        raise ConfigError("nothing to write: give --c, --px4, --ardupilot, --crazyflie, --mat, --csv or --law")
    for path, suffix in suffixes.items():
        if path.suffix != suffix:
            raise ConfigError(f"{path}: must end in {suffix}" if suffix else f"{path}: a folder has no suffix")
    for path in (*suffixes, *([c.with_suffix(".h")] if c else [])):
        if path.exists():
            raise ConfigError(f"{path}: exists already")
