"""The command `gustproof export`: a law for other tools."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError

if TYPE_CHECKING:
    from gustproof.export.folders import Firmware
    from gustproof.law.form import Law
    from gustproof.law.io.c import Attitude


def export(
    law: Annotated[str, typer.Argument(help="Name of a shipped law, a .json or .mat file, or a folder of tables.")],
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
            min=10, max=1000,
            help="Resample the law to this rate [Hz], if its loop stays good [default: the law's; 250 for PX4 and the "
            "Crazyflie, 400 for ArduCopter].",
        ),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(help="Vehicle of the loop and its rotors: a shipped one or a .toml file [default: the law's own]."),
    ] = None,
    mat: Annotated[Path | None, typer.Option("--mat", help="Write a MATLAB file here.")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Write tables of numbers to this new folder.")] = None,
    as_law: Annotated[
        Path | None, typer.Option("--law", help="Write a law file (.json) that can be flown here.")
    ] = None,
) -> None:
    """Export a law as C code with the same bits, into an autopilot, as a MATLAB file or as tables, or import one.

    gustproof export hinf-scheduled --c law.c

    gustproof export flagship --px4 my-law

    gustproof export flagship --rate 400 --c law.c --law flagship-400hz.json

    gustproof export mine.mat --law mine.json && gustproof fly paper-turbulence --law mine.json
    """
    from firmware_model.config.files import naming
    from gustproof.export.folders import Firmware
    from gustproof.law.io.c import Attitude, save_c
    from gustproof.law.io.matrices import read_law, save_csv, save_mat

    wanted = {path: suffix for path, suffix in ((c, ".c"), (mat, ".mat"), (csv, ""), (as_law, ".json")) if path}
    given = {Firmware.PX4: px4, Firmware.ARDUPILOT: ardupilot, Firmware.CRAZYFLIE: crazyflie}
    folders = {firmware: path for firmware, path in given.items() if path}
    _check_outputs({**wanted, **dict.fromkeys(folders.values(), "")}, [c.with_suffix(".h")] if c else [])
    sources = [source.value for source in Attitude]
    if attitude not in (None, *sources):
        raise ConfigError(f"--attitude: is '{attitude}', must be one of {', '.join(sources)}")
    source = Attitude(attitude) if attitude else None
    read = read_law(law)
    for firmware, path in folders.items():
        _export_folder(read, firmware, path, source, rate, vehicle)
    if not wanted:
        return
    if rate is not None:
        read = _resampled(read, rate, vehicle)
    elif vehicle is not None and not folders:
        raise ConfigError("--vehicle: belongs to --rate, the loop is checked on it")
    if c is not None:
        try:
            save_c(read, c, source or Attitude.OWN)
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


def _export_folder(
    law: "Law", firmware: "Firmware", path: Path, attitude: "Attitude | None", rate: int | None, vehicle: str | None
) -> None:
    """Write a folder for an autopilot; by default the autopilot's attitude, at its own rate."""
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.export.folders import RATES, firmware_folder, save_folder
    from gustproof.law.io.c import Attitude

    wanted = rate or RATES[firmware]
    law = _resampled(law, wanted, vehicle) if abs(wanted * law.dt - 1.0) > 1e-9 else law
    source = attitude or (Attitude.AUTOPILOT if law.is_scheduled else Attitude.OWN)
    body = load_vehicle(vehicle or law.provenance.vehicle)
    try:
        files = firmware_folder(firmware, law, body, source, path.name)
    except ValueError as error:
        raise ConfigError(f"--attitude: {error}") from None
    save_folder(files, path)
    print(f"law '{law.name}' for vehicle '{body.name}' in {path}, see its README.md")


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
        raise ConfigError("nothing to write: give --c, --px4, --ardupilot, --crazyflie, --mat, --csv or --law")
    for path, suffix in suffixes.items():
        if path.suffix != suffix:
            raise ConfigError(f"{path}: must end in {suffix}" if suffix else f"{path}: a folder has no suffix")
    for path in (*suffixes, *others):
        if path.exists():
            raise ConfigError(f"{path}: exists already")
