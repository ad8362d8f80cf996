"""Adapters of simulators by name."""

import importlib.util
from pathlib import Path

from firmware_model.errors import ConfigError
from gustproof.studies.audit.ardupilot import ArduPilotQuad
from gustproof.studies.audit.own import OwnSimulator
from gustproof.studies.audit.px4 import Px4Sih
from gustproof.studies.audit.rotorpy import load_rotorpy
from gustproof.studies.audit.simulator import Simulator


def load_simulator(name: str, build: Path | None = None) -> Simulator:
    """Return the adapter of a known simulator, or the one that `make_simulator()` of a Python file makes.

    `build` is the folder of an autopilot's build; without it the usual places are looked at.

    Raises
    ------
    ConfigError
        If there is no such adapter, or its simulator is not installed.
    """
    if name == "own":
        return OwnSimulator()
    if name == "rotorpy":
        return load_rotorpy()
    if name == "ardupilot":
        return ArduPilotQuad(build)
    if name == "px4":
        return Px4Sih(build)
    path = Path(name)
    if path.suffix != ".py":
        raise ConfigError(
            f"audit '{name}': must be own, rotorpy, ardupilot, px4 or a Python file with make_simulator()"
        )
    if not path.is_file():
        raise ConfigError(f"{path}: no such file")
    return _load_file(path)


def _load_file(path: Path) -> Simulator:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{path}: cannot be loaded as Python")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        simulator = module.make_simulator()
    except Exception as error:  # foreign code may raise anything
        raise ConfigError(f"{path}: {type(error).__name__}: {error}") from None
    if not isinstance(simulator, Simulator):
        raise ConfigError(f"{path}: make_simulator() must return a gustproof.studies.audit.simulator.Simulator")
    return simulator
