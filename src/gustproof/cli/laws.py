"""Laws as commands take them: shipped ones, law files, and parameter files of autopilots."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_model.config.validation import printable

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.uncertainty import VehicleSet
    from firmware_model.config.vehicle import Vehicle
    from gustproof.law.form import Law

PARAMETER_SUFFIXES = (".params", ".param", ".parm")
"""Ends of the names of autopilots' parameter files."""
LAW_HELP = (
    "Name of a shipped law, a .json or .mat file, or a folder of tables. Parameters of PX4 or ArduPilot (.params, "
    ".param) mean that autopilot's own loops."
)


def is_parameter_file(name_or_path: str) -> bool:
    """Return whether a name is that of an autopilot's parameter file."""
    return Path(name_or_path).suffix in PARAMETER_SUFFIXES


def find_law(name_or_path: str, vehicle: "Vehicle", rate_hz: int | None) -> "Law":
    """Return a law by name or file; loops of an autopilot on `vehicle`, at `rate_hz` or that of its simulation.

    What such loops have and the law lacks is told on stderr.

    Raises
    ------
    LawFileError
        If there is no such law, or its file is wrong.
    ConfigError
        If a parameter file is wrong.
    """
    from gustproof.law.io.matrices import read_law

    if not is_parameter_file(name_or_path):
        return read_law(name_or_path)
    from gustproof.autopilots.models import read_autopilot_law

    found = read_autopilot_law(Path(name_or_path), vehicle, rate_hz=rate_hz)
    for remark in found.remarks:
        print(f"{found.law.name}: {printable(remark)}", file=sys.stderr)
    return found.law


def default_law(vehicles: "VehicleSet", script: "Scenario", *, quiet: bool) -> "Law":
    """Return the default law, tuned for the vehicle if the shipped one is for another; a line on stderr says so.

    It is tuned in the turbulence of `paper-turbulence`, at the sample rate and delay of `script`.

    Raises
    ------
    DesignError
        If there is none.
    """
    from gustproof.controller import DEFAULT_LAW
    from gustproof.law.form import load_law

    shipped, name = load_law(DEFAULT_LAW), vehicles.nominal.name
    if shipped.provenance.vehicle == name:
        return shipped
    from dataclasses import replace

    from firmware_model.config.scenario import load_scenario
    from gustproof.cli.options import progress
    from gustproof.synthesis.tune import tune_law  # takes longer to import than the shipped law to fly

    air = replace(
        load_scenario("paper-turbulence"),
        control_rate_hz=script.control_rate_hz,
        physics_rate_hz=script.physics_rate_hz,
        delay_samples=script.delay_samples,
    )
    if not quiet:
        print(f"gustproof: no --law: tuning one for '{printable(name)}'", file=sys.stderr, flush=True)
    with progress(f"tuning {DEFAULT_LAW} for {name}", quiet=quiet) as shown:
        tuning = tune_law(DEFAULT_LAW, vehicles, air, progress=shown)
    price = f"Ms {tuning.Ms:.3g}, slew {tuning.slew:.3g} N m/s"
    print(f"gustproof: {DEFAULT_LAW} tuned for '{printable(name)}': {price}", file=sys.stderr)
    return tuning.law
