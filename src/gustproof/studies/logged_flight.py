"""All that the log of one flight tells: loops that flew, vibration, vehicle, and the judgement of its gains."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from firmware_model.config.scenario import load_scenario
from firmware_model.errors import ConfigError
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.logs.identify.flown_step import FlownStep, flown_steps
from gustproof.logs.identify.gyro_spectrum import GyroSpectrum, gyro_spectrum
from gustproof.logs.identify.shown_vehicle import ShownVehicle, show_vehicle
from gustproof.logs.read.flight_log import CommandUnit, FlightLog
from gustproof.studies.rate.filter_advice import FilterChoice, weigh_filters
from gustproof.studies.rate.flown_loops import doubt_flown_gains
from gustproof.studies.rate.judge import Judgement, Verdict, judge_law

NO_MASS = (
    "no log shows a mass: torques are those of the inertia of iris, and angles, rates and margins do not depend on it"
)
"""Remark on a judgement on the vehicle that a log shows."""
_USUAL_AIR = "paper-turbulence"
_FLEW_S = 10.0
_LIMITED = 0.1  # [-] of full scale, within which no loop's torque is limited in hover


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoggedFlight:
    """All that one log tells, and the reason for each part that it does not."""

    log: FlightLog
    """Signals and facts."""
    steps: tuple[FlownStep, ...] = ()
    """Responses of the loops that flew."""
    not_told: tuple[str, ...] = ()
    """Reason for each response that is not told."""
    spectrum: GyroSpectrum | None = None
    """Spectrum of the gyro; `None` if the log is too short in the air, or too slow."""
    shown: ShownVehicle | None = None
    """Vehicle and air; `None` if nothing can be identified."""
    no_vehicle: str = ""
    """Reason why there is no vehicle; empty if there is one."""
    filters: tuple[FilterChoice, ...] = ()
    """Filters that flew, then others, weighed on this flight's vibration; empty if they can't be."""
    judgement: Judgement | None = None
    """Judgement of the gains that flew, on this vehicle in this air; `None` if they can't be judged."""
    remarks: tuple[str, ...] = ()
    """Remarks on the model of the gains, a line each."""
    no_judgement: str = ""
    """Reason why there is no judgement; empty if there is one."""


def study_log(log: FlightLog, name: str, *, progress: Callable[[float, str], None]) -> LoggedFlight:
    """Return all that a log tells of its flight; what it does not tell is a reason, not an error.

    The vehicle is called `name`.
    """
    progress(0.02, "step responses and vibration")
    found = study_loops(log)
    try:
        check_class(log)
        shown = show_vehicle(log, name, progress=lambda share: progress(0.05 + 0.35 * share, "vehicle"))
    except ConfigError as error:
        return replace(found, no_vehicle=str(error), no_judgement=f"no vehicle: {error}")
    found = with_vehicle(found, shown)
    try:
        return _judge(found, shown, lambda share, text: progress(0.4 + 0.6 * share, text))
    except (ConfigError, ValueError) as error:
        return replace(found, no_judgement=str(error))


def study_loops(log: FlightLog) -> LoggedFlight:
    """Return the step responses and the vibration of a log, without its vehicle."""
    steps, not_told = flown_steps(log)
    return LoggedFlight(log=log, steps=tuple(steps), not_told=tuple(not_told), spectrum=gyro_spectrum(log))


def with_vehicle(found: LoggedFlight, shown: ShownVehicle) -> LoggedFlight:
    """Return the same with the vehicle, not judged."""
    refusal = "" if shown.file else shown.refusal
    return replace(found, shown=shown, no_vehicle=refusal, no_judgement=refusal or "`gustproof report` judges gains")


def logged_parameters(log: FlightLog) -> Mapping[str, float]:
    """Return the parameters of a log.

    Raises
    ------
    ConfigError
        If there are none, or no gains that are known.
    """
    if not log.parameters:
        raise ConfigError("the log has no parameters")
    if log.system in AUTOPILOTS:
        AUTOPILOTS[log.system].check_gains(log.parameters)
    return log.parameters


def check_class(log: FlightLog) -> None:
    """Refuse the log of another class of vehicle, whose command and rates are those of rudders, wheels or wings.

    Raises
    ------
    ConfigError
        If its parameters tell one that does not hover.
    """
    if log.system in AUTOPILOTS and (other := AUTOPILOTS[log.system].find_class(log.parameters)):
        raise ConfigError(f"{log.source}: {other}, only multicopters are identified")


def contradiction(log: FlightLog, judgement: Judgement) -> str:
    """Return the remark on gains that are unstable by the model and flew all the same; empty for others."""
    if judgement.verdict is not Verdict.UNSTABLE or log.aloft < _FLEW_S:
        return ""
    return refutation(log) or (
        f"yet they flew {log.aloft:.0f} s in this log: either they oscillated there, see its rates, or the loops that "
        "flew are not those of its parameters"
    )


def refutation(log: FlightLog) -> str:
    """Return how a flight refutes a model by which its gains are unstable; empty if it does not.

    The torque of an unstable loop grows until it is limited. In the flight its 95 % stayed far below that.
    """
    if log.command is None or log.command_unit is not CommandUnit.NORMALISED or log.aloft < _FLEW_S:
        return ""
    flown = log.in_air(log.command)
    most = float(np.quantile(np.abs(flown - np.median(flown, axis=0)), 0.95, axis=0).max()) if len(flown) else 1.0
    if most > _LIMITED:
        return ""
    return (
        f"yet they flew {log.aloft:.0f} s in this log with {100.0 * most:.2g} % of full torque, where that of an "
        "unstable loop grows until it is limited: the model, or the parameters, are not those of this flight"
    )


def _judge(found: LoggedFlight, shown: ShownVehicle, progress: Callable[[float, str], None]) -> LoggedFlight:
    """Return the flight with the judgement of its gains, and its filters weighed."""
    log, vehicles = found.log, shown.vehicles()
    if log.system not in AUTOPILOTS:
        raise ConfigError(f"gains of {log.system} are not known here: those of {' and '.join(AUTOPILOTS)} are")
    model = autopilot_law(log.system, logged_parameters(log), vehicles.nominal)
    air = shown.scenario() or load_scenario(_USUAL_AIR)
    judged = judge_law(model.law, vehicles, air, thrust_step=model.thrust_step, progress=progress)
    filters: tuple[FilterChoice, ...] = ()
    if found.spectrum is not None:
        filters = weigh_filters(log.system, log.parameters, found.spectrum, judged.vehicle, judged.scenario)
    return replace(
        found, judgement=judged, remarks=(*model.remarks, *doubt_flown_gains(log)), filters=filters, no_judgement=""
    )
