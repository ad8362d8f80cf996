"""The command `gustproof export`: a law for other tools."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError

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
        str | None, typer.Option(help="Vehicle of that loop: a shipped one or a .toml file [default: the law's own].")
    ] = None,
    mat: Annotated[Path | None, typer.Option("--mat", help="Write a MATLAB file here.")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Write tables of numbers to this new folder.")] = None,
    as_law: Annotated[
        Path | None, typer.Option("--law", help="Write a law file (.json) that can be flown here.")
    ] = None,
) -> None:
    """Export a law as C code with the same bits, as a MATLAB file or as tables, or import one.

    gustproof export hinf-scheduled --c law.c

    gustproof export flagship --rate 400 --c law.c --law flagship-400hz.json

    gustproof export mine.mat --law mine.json && gustproof fly paper-turbulence --law mine.json
    """
    from firmware_model.config.files import naming
    from gustproof.law.io.c import Attitude, save_c
    from gustproof.law.io.matrices import read_law, save_csv, save_mat

    wanted = {path: suffix for path, suffix in ((c, ".c"), (mat, ".mat"), (csv, ""), (as_law, ".json")) if path}
    _check_outputs(wanted, [c.with_suffix(".h")] if c else [])
    sources = [source.value for source in Attitude]
    if attitude not in sources:
        raise ConfigError(f"--attitude: is '{attitude}', must be one of {', '.join(sources)}")
    read = read_law(law)
    if rate is not None:
        read = _resampled(read, rate, vehicle)
    elif vehicle is not None:
        raise ConfigError("--vehicle: belongs to --rate, the loop is checked on it")
    if c is not None:
        try:
            save_c(read, c, Attitude(attitude))
        except ValueError as error:
            raise ConfigError(f"--attitude: {error}") from None
    if mat is not None:
        with naming(mat):
            save_mat(read, mat)
    if csv is not None:
        save_csv(read, csv)
    if as_law is not None:
        read.save(as_law)
    for path in wanted:
        header = f" and {path.with_suffix('.h').name}" if path == c else ""
        print(f"law '{read.name}' in {path}{header}")


def _resampled(law: "Law", rate: int, vehicle: str | None) -> "Law":
    """Return the law at another rate [Hz], and print its margins at both."""
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.analysis.law_margins import resample_at_hover
    from gustproof.errors import DesignError

    try:
        found = resample_at_hover(law, rate, load_vehicle(vehicle or law.provenance.vehicle))
    except (DesignError, ValueError) as error:
        raise ConfigError(f"--rate: {error}") from None
    for each, margins in ((law, found.before), (found.law, found.after)):
        figures = "its loop is the autopilot's own, not checked" if margins is None else (
            f"Ms {margins.Ms:.2f}, phase {margins.phase_margin_deg:.0f} deg, gain {margins.gain_margin:.1f}, "
            f"delay {1e3 * margins.delay_margin:.0f} ms"
        )  # fmt: skip
        print(f"{1.0 / each.dt:g} Hz: {figures}")
    return found.law


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
