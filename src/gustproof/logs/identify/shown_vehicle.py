"""The vehicle and the air that one log shows, with all that it does not tell taken from a known vehicle."""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass

from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet, make_vehicle_set
from firmware_model.errors import ConfigError
from firmware_model.types import AXES
from gustproof.logs.identify.air import IdentifiedAir, estimate_air, turbulence_scenario
from gustproof.logs.identify.identification import Identification
from gustproof.logs.identify.identify_vehicle import identify
from gustproof.logs.identify.vehicle_file import Known, VehicleFile, make_vehicle_file
from gustproof.logs.read.flight_log import FlightLog

_LIKE = "iris"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShownVehicle:
    """Vehicle and air of one log, as far as it shows them."""

    identification: Identification
    """Numbers with intervals, and the curves that support them."""
    file: VehicleFile | None
    """Vehicle file; `None` if no vehicle is shown."""
    air: IdentifiedAir | None
    """Disturbance as turbulence; `None` if none is shown."""
    refusal: str
    """Reason why vehicle or air is not shown; empty if both are."""
    findings: tuple[str, ...]
    """Doubts, a line each: those of the identification with what to fly for axes that it lacks, then the others."""

    def vehicles(self) -> VehicleSet:
        """Return the vehicle with its spreads, as from its file.

        Raises
        ------
        ConfigError
            If none is shown.
        """
        if self.file is None:
            raise ConfigError(self.refusal)
        name = self.file.vehicle.name
        return make_vehicle_set({"name": name} | tomllib.loads(self.file.text), name)

    def scenario(self) -> Scenario | None:
        """Return the scenario of its air; `None` if no air is shown."""
        return None if self.air is None else turbulence_scenario("its-own-air", self.air, self.identification)


def show_vehicle(
    log: FlightLog, name: str, known: Known | None = None, *, progress: Callable[[float], None] | None = None
) -> ShownVehicle:
    """Return the vehicle and the air of a log.

    A log shows no mass. If none is `known`, all that it does not show is of `iris`: angles, rates and margins do not
    depend on it, torques do.

    Raises
    ------
    ConfigError
        If the log has no commands, or is too short in the air.
    """
    found = identify(log, progress=progress)
    known = known or Known(like=_LIKE)
    file, air, refusal = None, None, ""
    try:
        file = make_vehicle_file(name, found, known)
        air = estimate_air(log, found, file.vehicle)
        file = make_vehicle_file(name, found, known, air)
    except ConfigError as error:
        refusal = str(error)
    findings = (*_doubts(found), refusal, *(file.findings if file else ()), air.doubt if air else "")
    return ShownVehicle(
        identification=found, file=file, air=air, refusal=refusal, findings=tuple(filter(None, findings))
    )


def _doubts(found: Identification) -> list[str]:
    """Return the findings, and the manoeuvre for each axis that is not identified."""
    advice = dict.fromkeys(axis.advice for axis in found.axes if axis.advice)
    lacking = [f"{axis} is not identified" for axis, each in zip(AXES, found.axes, strict=True) if each.advice]
    return [*(line for line in found.findings if line not in lacking), *advice]
