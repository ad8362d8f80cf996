"""The command `gustproof export`: a law for other tools."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.options import AsJson, print_json

if TYPE_CHECKING:
    from gustproof.law.form import Law


def export(
    law: Annotated[str, typer.Argument(help="Name of a shipped law, a .json or .mat file, or a folder of tables.")],
    c: Annotated[Path | None, typer.Option("--c", help="Write C code here, and its header beside it.")] = None,
    attitude: Annotated[
        str, typer.Option(help="C code: attitude of the law, its own or an estimate by the autopilot: own, autopilot.")
    ] = "own",
    rate: Annotated[
        int | None, typer.Option(min=10, max=1000, help="Resample the law to this rate [Hz], if its loop stays good.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(help="Vehicle of the checked loop: a shipped one or a .toml file [default: the law's own]."),
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
    """Export a law as C code with the same bits, as a MATLAB file or as tables, or import one.

    gustproof export hinf-scheduled --c law.c

    gustproof export flagship --rate 400 --c law.c --law flagship-400hz.json

    gustproof export mine.mat --law mine.json && gustproof fly paper-turbulence --law mine.json
    """
    from firmware_model.config.files import naming
    from gustproof.law.io.matrices import read_law, save_csv, save_mat

    wanted = {path: suffix for path, suffix in ((c, ".c"), (mat, ".mat"), (csv, ""), (as_law, ".json")) if path}
    _check_outputs(wanted, [c.with_suffix(".h")] if c else [])
    _check_options(c, rate, vehicle, attitude, float32=float32)
    told: dict[str, Any] = {}
    read = read_law(law)
    if rate is not None:
        read, told["margins"] = _resampled(read, rate, vehicle)
    told = {"law": read.name, "rate_hz": 1.0 / read.dt, "files": [str(path) for path in wanted], **told}
    if c is not None:
        told |= _save_c(read, c, attitude, float32=float32, vehicle=vehicle)
    if mat is not None:
        with naming(mat):
            save_mat(read, mat)
    if csv is not None:
        save_csv(read, csv)
    if as_law is not None:
        read.save(as_law)
    if as_json:
        print_json(told)
    else:
        _show(told, c)


def _check_options(c: Path | None, rate: int | None, vehicle: str | None, attitude: str, *, float32: bool) -> None:
    """Refuse options without those that they belong to."""
    if c is None and (float32 or attitude != "own"):
        raise ConfigError("--float32 and --attitude belong to --c")
    if vehicle is not None and rate is None and not float32:
        raise ConfigError("--vehicle: belongs to --rate and --float32, whose loops are checked on it")


def _show(told: dict[str, Any], c: Path | None) -> None:
    for hz, figures in told.get("margins", {}).items():
        print(f"{hz} Hz: {_describe_margins(figures)}")
    if "rounding" in told:
        print(told["rounding"]["statement"])
    for path in told["files"]:
        header = f" and {c.with_suffix('.h').name}" if c is not None and path == str(c) else ""
        print(f"law '{told['law']}' in {path}{header}")


def _save_c(law: "Law", path: Path, attitude: str, *, float32: bool, vehicle: str | None) -> dict[str, Any]:
    """Write the law as C code; return the cost of a step and, in single precision, what is proved of its rounding."""
    from gustproof.law.io.c import Attitude, save_c
    from gustproof.law.io.operations import INSTRUCTIONS

    sources = [source.value for source in Attitude]
    if attitude not in sources:
        raise ConfigError(f"--attitude: is '{attitude}', must be one of {', '.join(sources)}")
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


def _resampled(law: "Law", rate: int, vehicle: str | None) -> "tuple[Law, dict[str, Any]]":
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


def _check_outputs(suffixes: dict[Path, str], others: list[Path]) -> None:
    """Refuse files with a wrong suffix, and files that exist."""
    if not suffixes:
        raise ConfigError("nothing to write: give --c, --mat, --csv or --law")
    for path, suffix in suffixes.items():
        if path.suffix != suffix:
            raise ConfigError(f"{path}: must end in {suffix}" if suffix else f"{path}: a folder has no suffix")
    for path in (*suffixes, *others):
        if path.exists():
            raise ConfigError(f"{path}: exists already")
