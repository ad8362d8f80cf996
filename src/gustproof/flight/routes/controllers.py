"""Fly any controller and name the end of its flight: in this process, or by MAVLink in lockstep if it is a program."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.flight.controllers.library import load_library
from gustproof.flight.controllers.stepper import StepError, StepFault, make_stepper
from gustproof.flight.controllers.user_controller import Controller, ControllerKind, UserController
from gustproof.flight.routes.direct import fly_direct, fly_library, fly_stepper
from gustproof.flight.routes.loopback import fly_by_messages, fly_loopback
from gustproof.flight.routes.outcome import FlightOutcome, describe, infer_outcome
from gustproof.flight.routes.processes import fly
from gustproof.types import Records


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControllerFlight:
    """Result of a pilot's flight."""

    records: Records
    """(n,) journal records; fewer than the scenario has samples if the flight broke off."""
    outcome: FlightOutcome
    """End of the flight."""
    message: str
    """Outcome in one line, for people."""


def fly_controller(
    scenario: Scenario, controller: Controller, *, vehicle: Vehicle, seed: int = 1, nominal: Vehicle | None = None
) -> ControllerFlight:
    """Fly a scenario with a law or a user's controller and return what was flown, whatever its end.

    The maker of a user's controller gets `nominal`, by default the flown vehicle: what its user knows, not what is
    flown. If a program's set-points stop, the vehicle's own loops fly on.

    Raises
    ------
    ConfigError
        If the controller can't be made.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import fly_controller, load_law, load_scenario, load_vehicle
    >>> scenario = replace(load_scenario("paper-turbulence"), duration_s=0.1)
    >>> fly_controller(scenario, load_law("hinf-d1"), vehicle=load_vehicle("paper")).message
    'flown to the end'
    """
    if isinstance(controller, UserController) and controller.kind is ControllerKind.PROGRAM:
        with TemporaryDirectory() as folder:
            flight = fly(scenario, controller, vehicle=vehicle, seed=seed, out=Path(folder))
            return ControllerFlight(records=flight.records, outcome=flight.outcome, message=flight.message)
    if isinstance(controller, UserController):
        return _fly_user_controller(scenario, controller, vehicle, seed, vehicle if nominal is None else nominal)
    route = fly_loopback if scenario.has_link_script else fly_direct
    return _end(scenario, route(scenario, controller, vehicle=vehicle, seed=seed), None)


def _fly_user_controller(
    scenario: Scenario, entry: UserController, vehicle: Vehicle, seed: int, nominal: Vehicle
) -> ControllerFlight:
    if scenario.has_link_script:
        made = make_stepper(entry, nominal, scenario.dt)
        return _end(scenario, *fly_by_messages(scenario, made, vehicle=vehicle, seed=seed))
    if entry.kind is ControllerKind.LIBRARY and not (library := load_library(entry)).is_single:
        records, fault = fly_library(scenario, library, vehicle=vehicle, seed=seed)
        failure = StepError(StepFault.NOT_FINITE, f"controller '{entry.name}': commanded {fault}") if fault else None
        return _end(scenario, records, failure)
    return _end(scenario, *fly_stepper(scenario, make_stepper(entry, nominal), vehicle=vehicle, seed=seed))


def _end(scenario: Scenario, records: Records, failure: StepError | None) -> ControllerFlight:
    outcome = infer_outcome(records, scenario)
    if failure is not None and outcome is not FlightOutcome.DIVERGED:
        outcome = FlightOutcome[f"CONTROLLER_{failure.fault.name}"]
        return ControllerFlight(records=records, outcome=outcome, message=f"{outcome.value} ({failure})")
    return ControllerFlight(records=records, outcome=outcome, message=describe(outcome, scenario, records))
