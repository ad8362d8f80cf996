"""Laws as commands take them: shipped ones, law files, and parameter files of autopilots."""

import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_model.config.validation import printable
from firmware_model.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from firmware_model.config.scenario import Scenario
    from firmware_model.config.uncertainty import VehicleSet
    from firmware_model.config.vehicle import Vehicle
    from gustproof.flight.controllers.user_controller import Controller
    from gustproof.law.form import Law
    from gustproof.logs.read.flight_log import FlightLog

_LAW_SUFFIXES, _LOG_SUFFIXES = ("", ".json", ".mat"), (".ulg", ".bin", ".log", ".tlog", ".csv", ".bbl", ".bfl")
LAW_HELP = (
    "A shipped law, a .json or .mat file, or a folder of tables; parameters of PX4 or ArduPilot (.params, .param) for "
    "its own loops."
)


FLOWN_HELP = "A law as for 'fly', or your controller: MODULE.py:MAKER, LIBRARY.so, 'exec: COMMAND'."


def is_user_controller(source: str) -> bool:
    """Return whether a word names a user's own controller, not a law."""
    return ":" in source or source.endswith((".so", ".dylib", ".dll"))


def find_controller(source: str, vehicle: "Vehicle", rate_hz: int | None = None) -> "Controller":
    """Return a law by `find_law`, or a user's controller, which runs code: call it with words of the command line.

    Raises
    ------
    ConfigError
        If there is no such law or controller.
    """
    from gustproof.flight.controllers.user_controller import parse_controller

    return parse_controller(source) if is_user_controller(source) else find_law(source, vehicle, rate_hz)


def is_parameter_file(name_or_path: str | Path) -> bool:
    """Return whether a name is that of an autopilot's parameter file."""
    from firmware_model.config import parameter_files

    return parameter_files.is_parameter_file(name_or_path)


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
    from gustproof.law.write.matrices import read_law

    if not is_parameter_file(name_or_path):
        return read_law(name_or_path)
    from gustproof.design.loops.models import read_autopilot_law

    found = read_autopilot_law(Path(name_or_path), vehicle, rate_hz=rate_hz)
    tell_remarks(found.law.name, found.remarks)
    return found.law


def tell_remarks(name: str, remarks: Iterable[str]) -> None:
    """Print on stderr what the law of that name lacks of the loops that it stands for."""
    for remark in remarks:
        print(f"{name}: {printable(remark)}", file=sys.stderr)


def warn_of_repeated(files: Iterable[str], kind: str) -> None:
    """Print a warning on parameters that a file gives twice with different values; a wrong file is refused later."""
    from firmware_model.config.parameter_files import repeated_parameters

    for name in filter(None, files):
        with suppress(ConfigError):
            for line in repeated_parameters(name, kind):
                print(f"gustproof: warning: {printable(line)}", file=sys.stderr)


def find_law_vehicle(law: str, vehicle: str | None) -> str:
    """Return the vehicle that is given, or the shipped one that a law names; warn of one that it is not made for.

    Raises
    ------
    ConfigError
        If none is given, and the law names none that is shipped.
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.law.form import doubt_vehicle, load_law

    found = load_law(law)
    made_for, shipped = found.provenance.vehicle, found.provenance.shipped_vehicle
    if vehicle is None:
        if shipped is None:
            named = f"was designed for vehicle '{made_for}', which is not shipped" if made_for else "names no vehicle"
            raise ConfigError(f"law '{law}' {named}: give --vehicle FILE")
        return shipped
    if doubt := doubt_vehicle(found, load_vehicle(vehicle)):
        print(f"gustproof: warning: {printable(doubt)}", file=sys.stderr)
    return vehicle


def on_vehicle(script: "Scenario", vehicle: "Vehicle") -> "Scenario":
    """Return the scenario with the delay that a log of the vehicle measured; a line on stderr says so."""
    from firmware_model.config.scenario import with_measured_delay

    late = with_measured_delay(script, vehicle)
    if late is not script:
        name, delay = printable(vehicle.name), f"{late.delay_samples} samples late, not {script.delay_samples}"
        print(f"gustproof: commands act {delay}: '{name}' has a measured delay", file=sys.stderr, flush=True)
    return late


def choose_law(name_or_path: str | None, vehicles: "VehicleSet", script: "Scenario", *, quiet: bool) -> "Law":
    """Return a law for a flight, see `find_law`; without a name the default one, see `default_law`."""
    if name_or_path is None:
        return default_law(vehicles, script, quiet=quiet)
    return find_law(name_or_path, vehicles.nominal, script.control_rate_hz)


def default_law(vehicles: "VehicleSet", script: "Scenario", *, quiet: bool) -> "Law":
    """Return the default law, tuned for the vehicle if the shipped one is for another; a line on stderr says so.

    It is tuned in the turbulence of `paper-turbulence`, at the sample rate and delay of `script`.

    Raises
    ------
    DesignError
        If there is none.
    """
    from gustproof.flight.endpoint import DEFAULT_LAW
    from gustproof.law.form import load_law

    shipped, name = load_law(DEFAULT_LAW), vehicles.nominal.name
    if shipped.provenance.fits(vehicles.nominal):
        return shipped
    from dataclasses import replace

    from firmware_model.config.scenario import load_scenario
    from gustproof.cli.options import progress
    from gustproof.design.tune import tune_law  # takes longer to import than the shipped law to fly

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
    point = f"Ms {tuning.Ms:.3g}, slew {tuning.slew:.3g} N m/s"
    print(f"gustproof: {DEFAULT_LAW} tuned for '{printable(name)}': {point}", file=sys.stderr)
    return tuning.law


def is_log(name_or_path: str) -> bool:
    """Return whether a name is that of a flight log."""
    return Path(name_or_path).suffix.lower() in _LOG_SUFFIXES


def read_gains(
    gains: str, vehicle: "Vehicle", over: str | None = None, log: "FlightLog | None" = None
) -> "tuple[Law, float, tuple[str, ...]]":
    """Return the law of a file's gains, the step of its rotors' thrust [N], and remarks on the model.

    A parameter file is loaded `over` other parameters, those of a log or of a file, as a ground station loads it. The
    `log` is that of the name that is one, if it is read already.

    Raises
    ------
    ConfigError
        If a file is wrong, or there is one to load over that is not of the same autopilot.
    """
    from gustproof.design.loops.models import AUTOPILOTS, autopilot_law, read_autopilot_law
    from gustproof.law.write.matrices import read_law
    from gustproof.logs.read.read_log import read_log
    from gustproof.studies.rate.flown_loops import doubt_flown_gains

    path = Path(gains)
    if over is not None:
        return _read_over(path, over, vehicle, log)
    if gains in AUTOPILOTS:
        model = autopilot_law(gains, {}, vehicle)
        return model.law, model.thrust_step, model.remarks
    if path.suffix in _LAW_SUFFIXES and not is_parameter_file(path):
        return read_law(gains), 0.0, ()
    findings: tuple[str, ...] = ()
    if is_log(gains):
        log = log or read_log(path)
        model = autopilot_law(log.system, logged_parameters(path, log), vehicle)
        findings = (*doubt_flown_gains(log), *log.findings)
    else:
        model = read_autopilot_law(path, vehicle)
    return model.law, model.thrust_step, (*model.remarks, *findings)


def _read_over(
    path: Path, over: str, vehicle: "Vehicle", log: "FlightLog | None"
) -> "tuple[Law, float, tuple[str, ...]]":
    from gustproof.design.loops.models import read_autopilot_law
    from gustproof.studies.rate.advice import autopilot_kind

    below, _, remarks = read_gains(over, vehicle, log=log)
    kind, is_file = autopilot_kind(below), is_parameter_file(str(path))
    model = read_autopilot_law(path, vehicle, over=below.provenance.parameters) if kind and is_file else None
    if model is None or autopilot_kind(model.law) != kind:
        raise ConfigError(f"--over {over}: a parameter file is loaded over parameters of its own autopilot")
    return model.law, model.thrust_step, tuple(dict.fromkeys((*model.remarks, *remarks)))


def logged_parameters(path: Path, log: "FlightLog") -> "Mapping[str, float]":
    """Return the parameters of a log, the file `path`.

    Raises
    ------
    ConfigError
        If there are none, or no gains that are known.
    """
    from gustproof.studies import logged_flight

    try:
        return logged_flight.logged_parameters(log)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
