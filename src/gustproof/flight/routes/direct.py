"""The direct route: plant kernel and law kernel in one compiled loop, without messages; equal to the bit to UDP."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot.modes import Mode
from firmware_model.autopilot.parameters import Parameters, published_hover, published_limit
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.physics.sensors import float32
from firmware_model.recording.journal import FORCE_B, GYRO_B, WIDTH, as_records, record_type
from firmware_model.session.link import BEGINS_TO_HOLD, IN_TRIM, LinkSchedule, answered_at_once
from firmware_model.sim import inner_loop
from firmware_model.sim.layout import HOLDS_PLACE, X_STABILIZER, X_TILT_DEG
from firmware_model.sim.state import Array, SimState, initial_state
from firmware_model.sim.step import advance, advance_kernel, observe, observe_kernel
from gustproof.flight.controllers.library import Library, call_step
from gustproof.flight.controllers.stepper import CheckedStepper, StepError
from gustproof.flight.recording.flown import FlownRecords
from gustproof.law.form import Law, Output, find_vehicle
from gustproof.law.references import RADIANS, describe_other_rate, describe_untracked, references
from gustproof.law.step import FORCE, SparseLaw, law_kernel, no_law, sparse_law, vector_size


class UnfitError(ConfigError, ValueError):
    """A controller that cannot fly a scenario, whatever the vehicle."""


_AGE, _MODE = WIDTH - 2, WIDTH - 1
_MESSAGES = "must be flown with messages"


class _DirectFlight(NamedTuple):
    """Everything that the loop of a flight reads and writes."""

    sim: SimState
    """Simulation."""
    law: SparseLaw
    """Terms of the law, unused by a controller in C."""
    step: int
    """Address of the step of a controller in C; 0 for a law."""
    reference: Array
    """(samples, 3) [rad] phi, theta, psi."""
    scale: Array
    """(3,) [N*m or rad/s] B, command that is 1.0 on the wire."""
    thrust: float
    """[-] thrust beside rates; NaN beside torques."""
    kind: float
    """[-] kind of set-point, see `sim.inner_loop`."""
    bound: float
    """[-] largest magnitude of the command on the wire."""
    z: Array
    """(vector_size,) vector that the law sums, see `law.step`."""
    command: Array
    """(3,) [N*m or rad/s] B."""
    work: Array
    """(n,) next states of the law."""
    schedule: LinkSchedule
    """Samples that the law steps with, and commands that act."""
    commands: Array
    """(n, SETPOINT_WIDTH) latest commands; that of sample k stands at k modulo n."""
    held: Array
    """(SETPOINT_WIDTH,) attitude to hold where commands have stopped."""
    ring: Array
    """(delay + 1, SETPOINT_WIDTH) latest set-points."""
    records: Array
    """(samples, numbers) journal records."""


def fly_direct(
    scenario: Scenario,
    law: Law,
    *,
    vehicle: Vehicle | None = None,
    seed: int = 1,
    reference: Array | None = None,
) -> FlownRecords:
    """Fly a scenario without messages and return the journal's records (samples,) of its `record_type`.

    Without `vehicle` it is the shipped one that the law was made for. `reference` (samples, 3) [rad] is the attitude
    phi, theta, psi to hold; the scenario's by default.

    Raises
    ------
    ValueError
        If the law's sample time is not the scenario's, or the reference has another shape. If a reference is not
        finite, or no vehicle is known.
    NeedsMessages
        If the script kills the controller, sets modes, or loses the stream of commands.

    Examples
    --------
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle
    >>> records = fly_direct(load_scenario("gust-roll"), load_law("hinf-d1"), vehicle=load_vehicle("paper"))
    >>> (records["q_NB"].shape, float(records["time_us"][1]))
    ((2500, 4), 4000.0)
    """
    flown = find_vehicle(law, vehicle, scenario)
    _check_rate(scenario, law)
    reference = references(scenario) if reference is None else np.ascontiguousarray(reference)
    if reference.shape != (scenario.samples, 3):
        raise ValueError(f"reference has shape {reference.shape}, must be {(scenario.samples, 3)}")
    if not np.isfinite(reference).all():
        raise ValueError(f"reference is not finite from sample {int(np.argmin(np.isfinite(reference).all(axis=1)))} on")
    flight = _make_flight(scenario, flown, seed, law)._replace(reference=reference)
    _fly(flight)
    return FlownRecords.of(as_records(flight.records), law.name)


def fly_library(
    scenario: Scenario, library: Library, *, vehicle: Vehicle, seed: int = 1
) -> tuple[NDArray[np.void], str]:
    """Fly a scenario with a controller in C, without messages, its function called in the compiled loop.

    Return the records up to its first command that is not finite, and that command in words, empty if there is none.

    Raises
    ------
    ValueError
        If its sample time is not the scenario's, or it is in single precision.
    NeedsMessages
        If the script needs messages, see `fly_direct`.
    """
    _check_rate(scenario, library)
    if library.is_single:
        raise ValueError(f"law '{library.name}' is in single precision, must be called from Python")
    flight = _make_flight(scenario, vehicle, seed, library)._replace(step=library.step)
    flight.z[: library.order] = library.initial_state()
    flown = _fly(flight)
    fault = "" if flown == scenario.samples else ", ".join(f"{each:g}" for each in flight.command)
    return as_records(flight.records[:flown]), fault


def fly_stepper(
    scenario: Scenario, stepper: CheckedStepper, *, vehicle: Vehicle, seed: int = 1
) -> tuple[NDArray[np.void], StepError | None]:
    """Fly a scenario with a controller object, without messages; return the records so far and its failure, if any.

    The kernels are those of `fly_direct`, called sample by sample.

    Raises
    ------
    NeedsMessages
        If the script needs messages, see `fly_direct`.
    """
    _check_rate(scenario, stepper)
    flight = _make_flight(scenario, vehicle, seed, stepper)
    sim, ring, late, k = flight.sim, flight.ring, len(flight.ring), 0
    try:
        with stepper.limit_time():
            stepper.reset()
            for k, record in enumerate(flight.records):
                observe(sim, k, record)
                if flight.schedule.taken[k]:
                    # Copies: the controller may keep or change what it gets.
                    gyro, force = record[GYRO_B : GYRO_B + 3].copy(), record[FORCE_B : FORCE_B + 3].copy()
                    reference = flight.reference[k].copy()
                    if scenario.holds_place:
                        reference[:2] = RADIANS * sim.state[X_TILT_DEG : X_TILT_DEG + 2]
                    flight.command[:] = stepper.step(gyro, reference, force, scenario.dt)
                    _pack_command(flight, k)
                _choose_setpoint(flight, k)
                advance(sim, k, ring[(k + 1) % late], record)
    except StepError as failure:
        return as_records(flight.records[:k]), failure
    return as_records(flight.records), None


def _make_flight(
    scenario: Scenario, vehicle: Vehicle, seed: int, controller: Law | Library | CheckedStepper
) -> _DirectFlight:
    """Return a flight that has not begun; its reference is the scenario's."""
    terms = sparse_law(controller) if isinstance(controller, Law) else no_law()
    sim, torque = initial_state(vehicle, scenario, seed), controller.output is Output.TORQUE
    schedule, delay = _find_schedule(scenario, vehicle, seed, torque=torque), scenario.delay_samples
    records = np.full((scenario.samples, record_type(vehicle.rotors.count).itemsize // 8), np.nan)
    records[delay:, _AGE] = (np.arange(scenario.samples) - _stamps(schedule.acting, delay))[delay:]
    records[:, _MODE] = Mode.OFFBOARD.value
    lag = np.arange(scenario.samples) - schedule.acting
    commands = np.zeros((1 + lag[schedule.acting >= 0].max(initial=0), inner_loop.SETPOINT_WIDTH))
    ring = np.zeros((delay + 1, inner_loop.SETPOINT_WIDTH))
    ring[:, inner_loop.THRUST] = np.nan
    return _DirectFlight(
        sim, terms, 0,
        reference=references(scenario), scale=np.array(published_limit(vehicle)) if torque else np.ones(3),
        thrust=np.nan if torque else published_hover(vehicle),
        kind=inner_loop.TORQUE if torque else inner_loop.RATES, bound=1.0 if torque else np.inf,
        z=np.zeros(vector_size(terms, controller.order)), command=np.zeros(3), work=np.zeros(controller.order),
        schedule=schedule, commands=commands, held=np.zeros(inner_loop.SETPOINT_WIDTH), ring=ring, records=records,
    )  # fmt: skip


def _find_schedule(scenario: Scenario, vehicle: Vehicle, seed: int, *, torque: bool) -> LinkSchedule:
    """Return what the script's link does to the flight.

    Raises
    ------
    NeedsMessages
        If that is decided in flight.
    """
    if not scenario.has_link_script:
        return answered_at_once(scenario.samples)
    # Here, as the messages load a dialect that no other direct flight needs.
    from firmware_model.mavlink.messages import imu_template, rate_template, torque_template
    from firmware_model.session.link_schedule import link_schedule

    template = (torque_template if torque else rate_template)(1)
    sizes = imu_template(1).size, template.size
    timeout_us = Parameters(vehicle, scenario).settings().stream_timeout_us
    schedule = link_schedule(scenario, seed, sizes, timeout_us)
    if schedule is None:
        raise NeedsMessages(f"scenario '{scenario.name}' loses its controller or scripts modes, {_MESSAGES}")
    return schedule


def _stamps(acting: NDArray[np.int64], delay: int) -> Array:
    """Return the number of the sample whose command's stamp each acting set-point has; NaN where it has none."""
    come = np.maximum.accumulate(acting)  # a held attitude has the stamp of the last command
    stamps = np.where(come >= 0, come, np.nan)
    return np.concatenate([np.full(delay, np.nan), stamps[: len(stamps) - delay]])


class NeedsMessages(ValueError):
    """A script that must be flown with messages: its effect on the controller is decided in flight."""


def check_compatible(scenario: Scenario, law: Law | Library) -> None:
    """Check that a law can fly a scenario side by side with other flights.

    Raises
    ------
    ValueError
        If the law's sample time is not the scenario's, or it can't track what a position loop asks for.
    NeedsMessages
        If the script says what the link does: each flight's own.
    """
    if scenario.has_link_script:
        raise NeedsMessages(f"scenario '{scenario.name}' scripts link, controller or modes, {_MESSAGES}")
    _check_rate(scenario, law)


def _check_rate(scenario: Scenario, law: Law | Library | CheckedStepper) -> None:
    if (
        line := describe_other_rate(scenario, law.name, law.dt)
        or scenario.unread
        or (describe_untracked(scenario, law) if isinstance(law, Law) else "")
    ):
        raise UnfitError(line)


@kernel
def _pack_command(flight: _DirectFlight, sample: int) -> None:
    """Write the command and thrust of a sample as a set-point, as they are on the wire; see `sim.inner_loop`."""
    setpoint = flight.commands[sample % flight.commands.shape[0]]
    setpoint[0], setpoint[inner_loop.THRUST] = flight.kind, flight.thrust
    for i in range(3):
        setpoint[1 + i] = min(max(float32(flight.command[i] / flight.scale[i]), -flight.bound), flight.bound)


@kernel
def _choose_setpoint(flight: _DirectFlight, sample: int) -> None:
    """Write the set-point of a sample: the command that acts, the trim, or the attitude that the vehicle estimates."""
    acting, held, chosen = flight.schedule.acting[sample], flight.held, flight.ring[sample % flight.ring.shape[0]]
    if acting == BEGINS_TO_HOLD:
        held[0], held[inner_loop.THRUST] = inner_loop.ATTITUDE, flight.thrust
        for i in range(4):
            held[1 + i] = flight.sim.state[X_STABILIZER + i]
    for i in range(chosen.size):
        chosen[i] = flight.commands[acting % flight.commands.shape[0], i] if acting >= 0 else held[i]
    if acting == IN_TRIM:
        chosen[0] = inner_loop.TRIM


@compiled
def _fly(flight: _DirectFlight) -> int:
    """Fly, and return the count of samples: fewer than all if a controller in C commands no finite number."""
    sim, records, ring, z, command = flight.sim, flight.records, flight.ring, flight.z, flight.command
    n, late = flight.work.size, ring.shape[0]
    for k in range(records.shape[0]):
        record = records[k]
        observe_kernel(sim, k, record)
        if flight.schedule.taken[k]:
            for i in range(3):
                z[n + i] = record[GYRO_B + i]
                z[n + 3 + i] = flight.reference[k, i]
                z[n + FORCE + i] = record[FORCE_B + i]
            if sim.params[HOLDS_PLACE] != 0.0:
                for i in range(2):
                    z[n + 3 + i] = RADIANS * sim.state[X_TILT_DEG + i]
            if flight.step != 0:
                call_step(flight.step, z, z[n:], command)
                if not (math.isfinite(command[0]) and math.isfinite(command[1]) and math.isfinite(command[2])):
                    return k
            else:
                law_kernel(flight.law, z, command, flight.work)
            _pack_command(flight, k)
        _choose_setpoint(flight, k)
        advance_kernel(sim, k, ring[(k + 1) % late], record)
    return int(records.shape[0])
