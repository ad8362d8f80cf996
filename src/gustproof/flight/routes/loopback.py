"""A flight over datagrams that never leave this process, on a virtual clock.

The protocol cores are those of the two processes; law, scenario and seed give the same bits as over UDP.
"""

from contextlib import nullcontext

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.mavlink.frames import Address
from firmware_model.mavlink.wire import NO_SOCKET, move_frame
from firmware_model.numerics.compiled import compiled
from firmware_model.recording.journal import as_records, record_type
from firmware_model.session.exchange import SampleTurns, fly_sample
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.types import NEVER_US
from gustproof.flight.controllers.stepper import StepError
from gustproof.flight.endpoint.core import Flown
from gustproof.flight.endpoint.endpoint import ControllerEndpoint
from gustproof.flight.endpoint.exchange import LawTurns, answer_sample
from gustproof.flight.recording.flown import FlownRecords
from gustproof.flight.routes.flight import kill_schedule
from gustproof.law.form import Law, find_vehicle
from gustproof.types import Array, Records

Sent = list[tuple[bytes, Address]]
"""Datagrams, with their addresses."""
_VEHICLE, _CONTROLLER, _SPARE = (0, ("vehicle", 1)), (0, ("controller", 1)), (0, ("controller", 2))


def fly_loopback(scenario: Scenario, law: Law, *, vehicle: Vehicle | None = None, seed: int = 1) -> FlownRecords:
    """Fly a scenario in lockstep, vehicle and controller in this process, and return the journal records (n,).

    Without `vehicle` it is the shipped one that the law was made for.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import fly_direct, fly_loopback, load_law, load_scenario, load_vehicle
    >>> scenario = replace(load_scenario("paper-turbulence"), duration_s=0.1)
    >>> law, vehicle = load_law("hinf-d1"), load_vehicle("paper")
    >>> fly_loopback(scenario, law, vehicle=vehicle).tobytes() == fly_direct(scenario, law, vehicle=vehicle).tobytes()
    True
    """
    records, _ = fly_by_messages(scenario, law, vehicle=find_vehicle(law, vehicle, scenario), seed=seed)
    return FlownRecords.of(records, law.name)


def fly_by_messages(
    scenario: Scenario, controller: Flown, *, vehicle: Vehicle, seed: int = 1
) -> tuple[Records, StepError | None]:
    """Fly as `fly_loopback` does; return the records, up to the failure of a user's controller, and that failure."""
    rows: list[Array] = []
    try:
        with nullcontext() if isinstance(controller, Law) else controller.limit_time():
            failure = _fly(scenario, controller, vehicle, seed, rows)
    except StepError as hung:
        failure = hung
    records = as_records(np.array(rows)) if rows else np.empty(0, dtype=record_type(vehicle.rotors.count))
    return records, failure


def _alternate(vehicle: VehicleEndpoint, controller: ControllerEndpoint, sent: Sent, now_us: int) -> Sent:
    """Let both sides exchange samples and commands in machine code, if they can; return what is then to be carried."""
    if len(sent) != 1 or controller.finished:
        return sent
    [(datagram, peer)] = sent
    if (samples := vehicle.begin_exchange()) is None or (answers := controller.begin_exchange()) is None:
        return sent
    if not answers.line.put(datagram):
        return sent
    _exchange(samples, answers)
    controller.end_exchange(answers, now_us)
    vehicle.end_exchange(samples, now_us)
    if answers.line.turns > samples.line.turns:
        vehicle.receive(answers.line.answer, peer, now_us)
        return []
    return [(samples.line.answer, peer)] if samples.line.turns else sent


@compiled
def _exchange(samples: SampleTurns, answers: LawTurns) -> None:
    down, up = samples.line, answers.line
    for turn in range(min(samples.turns, answers.turns)):
        if answer_sample(NO_SOCKET, answers, turn, 0) < 0:
            return
        move_frame(up.given, down.taken)
        if not fly_sample(NO_SOCKET, samples, turn):
            return
        move_frame(down.given, up.taken)


def _fly(scenario: Scenario, law: Flown, vehicle: Vehicle, seed: int, rows: list[Array]) -> StepError | None:
    """Fly, append each record to `rows`, and return the failure of a user's controller, which ends the flight."""
    autopilot = VehicleEndpoint(
        vehicle, scenario, seed, lambda records: rows.extend(np.atleast_2d(records).copy()), lockstep=True
    )
    controller, peer = ControllerEndpoint(law, _VEHICLE, references=scenario.references), _CONTROLLER
    kill = kill_schedule(scenario)
    now_us = 0
    while not autopilot.finished and controller.failure is None:
        sent = autopilot.poll(now_us)
        if kill is not None and len(rows) >= kill[1]:
            controller = ControllerEndpoint(law, _VEHICLE, references=scenario.references)
            peer, kill = _SPARE, None
        sent = _alternate(autopilot, controller, sent, now_us)
        dead = controller.finished or (kill is not None and len(rows) >= kill[0])
        for datagram, to in () if dead else sent:
            if to == peer:
                controller.receive(datagram, _VEHICLE, now_us)
        answers = [] if dead else controller.poll(now_us)
        for answer, _ in answers:
            autopilot.receive(answer, peer, now_us)
        if not sent and not answers:
            now_us = max(now_us + 1, min(autopilot.deadline_us(), NEVER_US if dead else controller.deadline_us()))
    return controller.failure
