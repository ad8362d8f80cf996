"""Fly any controller and name the end of its flight: in this process, or by MAVLink in lockstep if it is a program."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.errors import FlightError
from gustproof.flight.controllers.external_autopilot import AnyController, ExternalAutopilot
from gustproof.flight.controllers.library import load_library
from gustproof.flight.controllers.stepper import StepError, StepFault, make_stepper
from gustproof.flight.controllers.user_controller import ControllerKind, UserController
from gustproof.flight.routes.direct import NeedsMessages, fly_direct, fly_library, fly_stepper
from gustproof.flight.routes.external import fly_external
from gustproof.flight.routes.flight import Flight, FlightPlan
from gustproof.flight.routes.loopback import fly_by_messages, fly_loopback
from gustproof.flight.routes.outcome import FlightOutcome, describe, infer_outcome
from gustproof.flight.routes.processes import fly
from gustproof.flight.scoring.metrics import Metrics
from gustproof.law.form import Law, find_vehicle
from gustproof.types import Records

_Flown = tuple[Records, FlightOutcome, str]


def fly_controller(
    scenario: Scenario,
    controller: AnyController,
    *,
    vehicle: Vehicle | None = None,
    seed: int = 1,
    nominal: Vehicle | None = None,
) -> Flight:
    """Fly a scenario with a law, a user's controller or a real autopilot; return what was flown, whatever its end.

    Without `vehicle` it is the shipped one that the law was made for. The maker of a user's controller gets `nominal`,
    by default the flown vehicle: what its user knows, not what is flown. If a program's set-points stop, the vehicle's
    own loops fly on.

    Raises
    ------
    ConfigError
        If the controller can't be made, or the autopilot not be started.
    ValueError
        If no vehicle is given, and the controller is no law of a shipped one.

    Examples
    --------
    >>> from gustproof import fly_controller, load_law, load_scenario
    >>> fly_controller(load_scenario("gust-roll"), load_law("flagship"))
    gust-roll: flagship on vehicle paper, seed 1
    end: flown to the end
    RMSE: 0.0491 deg (roll 0.0786, pitch 0.0286, yaw 0.0159)
    peak: 0.389 deg (roll 0.389, pitch 0.0617, yaw 0.0393)
    torque: rms 0.117 N m, peak 0.991 N m, slew rms 19.8 N m/s, at a limit for 0 s
    requirements: 3 of 3 met
    """
    flown = find_vehicle(controller, vehicle, scenario)
    if isinstance(controller, ExternalAutopilot):
        with TemporaryDirectory() as folder:
            plan = FlightPlan(scenario, controller, flown, seed, real_time=False)
            return replace(fly_external(plan, Path(folder)), journal=None)
    records, outcome, message = _fly(scenario, controller, flown, seed, nominal or flown)
    return Flight(
        scenario=scenario,
        controller=controller,
        vehicle=flown,
        seed=seed,
        records=records,
        outcome=outcome,
        message=message,
        nominal=nominal,
    )


def fly_to_end(scenario: Scenario, autopilot: ExternalAutopilot, vehicle: Vehicle, seed: int) -> tuple[Flight, Metrics]:
    """Fly a scenario with a real autopilot; return the flight and its figures.

    Raises
    ------
    ConfigError
        If the autopilot can't be started.
    FlightError
        If the flight broke off.
    """
    flight = fly_controller(scenario, autopilot, vehicle=vehicle, seed=seed)
    if flight.outcome is FlightOutcome.INTERRUPTED:
        raise KeyboardInterrupt  # taken by the flight, for its recording
    if flight.outcome is not FlightOutcome.DONE or flight.metrics is None:
        raise FlightError(flight.message)
    return flight, flight.metrics


def _fly(scenario: Scenario, controller: Law | UserController, vehicle: Vehicle, seed: int, nominal: Vehicle) -> _Flown:
    if isinstance(controller, UserController) and controller.kind is ControllerKind.PROGRAM:
        with TemporaryDirectory() as folder:
            flight = fly(scenario, controller, vehicle=vehicle, seed=seed, out=Path(folder))
            return flight.records, flight.outcome, flight.message
    if isinstance(controller, UserController):
        return _fly_user_controller(scenario, controller, vehicle, seed, nominal)
    return _end(scenario, fly_here(scenario, controller, vehicle=vehicle, seed=seed), None)


def fly_here(scenario: Scenario, law: Law, *, vehicle: Vehicle, seed: int = 1) -> Records:
    """Fly a law in this process, without messages where the script needs none; return the records (n,)."""
    try:
        return fly_direct(scenario, law, vehicle=vehicle, seed=seed)
    except NeedsMessages:
        return fly_loopback(scenario, law, vehicle=vehicle, seed=seed)


def _fly_user_controller(
    scenario: Scenario, entry: UserController, vehicle: Vehicle, seed: int, nominal: Vehicle
) -> _Flown:
    try:
        return _fly_without_messages(scenario, entry, vehicle, seed, nominal)
    except NeedsMessages:
        made = make_stepper(entry, nominal, scenario.dt)
        return _end(scenario, *fly_by_messages(scenario, made, vehicle=vehicle, seed=seed))


def _fly_without_messages(
    scenario: Scenario, entry: UserController, vehicle: Vehicle, seed: int, nominal: Vehicle
) -> _Flown:
    if entry.kind is ControllerKind.LIBRARY and not (library := load_library(entry)).is_single:
        records, fault = fly_library(scenario, library, vehicle=vehicle, seed=seed)
        failure = StepError(StepFault.NOT_FINITE, f"controller '{entry.name}': commanded {fault}") if fault else None
        return _end(scenario, records, failure)
    return _end(scenario, *fly_stepper(scenario, make_stepper(entry, nominal), vehicle=vehicle, seed=seed))


def _end(scenario: Scenario, records: Records, failure: StepError | None) -> _Flown:
    outcome = infer_outcome(records, scenario)
    if failure is not None and outcome is not FlightOutcome.DIVERGED:
        outcome = FlightOutcome[f"CONTROLLER_{failure.fault.name}"]
        return records, outcome, f"{outcome.value} ({failure})"
    return records, outcome, describe(outcome, scenario, records)
