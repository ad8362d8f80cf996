"""The direct route: plant kernel and law kernel in one compiled loop, no messages; equal to the bit to UDP."""

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot.modes import Mode
from firmware_model.autopilot.parameters import published_hover, published_limit
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.numerics.compiled import compiled
from firmware_model.physics.sensors import float32
from firmware_model.recording.journal import FORCE_B, GYRO_B, RECORD, WIDTH
from firmware_model.sim import inner_loop
from firmware_model.sim.state import Array, initial_state
from firmware_model.sim.step import advance_kernel, observe_kernel
from gustproof.law.form import Law, Output
from gustproof.law.references import references
from gustproof.law.step import EXTRA_SIZE, SparseLaw, law_kernel, sparse_law

_AGE, _MODE = WIDTH - 2, WIDTH - 1


def fly_direct(
    scenario: Scenario, law: Law, *, vehicle: Vehicle, seed: int = 1, reference: Array | None = None
) -> NDArray[np.void]:
    """Fly a scenario without messages and return the journal's records (samples,) of `RECORD`.

    `reference` (samples, 3) [rad] is what the law is asked to hold, phi, theta, psi; the scenario's by default.

    Raises
    ------
    ValueError
        If the law's sample time is not the scenario's, the reference has another shape, or the script is of messages.

    Examples
    --------
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle
    >>> records = fly_direct(load_scenario("gust-roll"), load_law("hinf-d1"), vehicle=load_vehicle("paper"))
    >>> (records["q_NB"].shape, float(records["time_us"][1]))
    ((2500, 4), 4000.0)
    """
    check_compatible(scenario, law)
    reference = references(scenario) if reference is None else np.ascontiguousarray(reference)
    if reference.shape != (scenario.samples, 3):
        raise ValueError(f"reference has shape {reference.shape}, must be {(scenario.samples, 3)}")
    world = initial_state(vehicle, scenario, seed)
    records = np.empty((scenario.samples, WIDTH))
    records[: scenario.delay_samples, _AGE], records[scenario.delay_samples :, _AGE] = np.nan, scenario.delay_samples
    records[:, _MODE] = Mode.OFFBOARD.value
    torque = law.output is Output.TORQUE
    scale = np.array(published_limit(vehicle)) if torque else np.ones(3)
    ring = np.zeros((scenario.delay_samples + 1, inner_loop.SETPOINT_WIDTH))
    ring[:, inner_loop.THRUST] = np.nan
    _fly(
        world.params, world.state, world.waves, world.replay, world.changes, world.seed, scenario.sample_us,
        sparse_law(law), reference, scale, inner_loop.TORQUE if torque else inner_loop.RATES, 1.0 if torque else np.inf,
        np.nan if torque else published_hover(vehicle), np.zeros(law.order + EXTRA_SIZE), np.zeros(3), np.zeros(law.order),
        ring, records,
    )  # fmt: skip
    return records.view(RECORD)[:, 0]


def check_compatible(scenario: Scenario, law: Law) -> None:
    """Check that a law can fly a scenario without messages.

    Raises
    ------
    ValueError
        If the law's sample time is not the scenario's, or the script is of messages.
    """
    if scenario.has_link_script:
        raise ValueError(f"scenario '{scenario.name}' scripts link, controller or modes, must be flown with messages")
    if law.dt != scenario.dt:
        raise ValueError(f"law '{law.name}' steps every {law.dt} s, scenario '{scenario.name}' every {scenario.dt} s")


@compiled
def _fly(params: Array, state: Array, waves: Array, replay: Array, changes: Array, seed: int, sample_us: int,
         law: SparseLaw, reference: Array, scale: Array, kind: float, bound: float, thrust: float, z: Array,
         command: Array, work: Array, ring: Array, records: Array) -> None:  # fmt: skip
    n, late = work.size, ring.shape[0]
    for k in range(records.shape[0]):
        record = records[k]
        observe_kernel(params, state, waves, replay, changes, seed, k, sample_us, record)
        for i in range(3):
            z[n + i] = record[GYRO_B + i]
            z[n + 3 + i] = reference[k, i]
            z[n + 6 + i] = record[FORCE_B + i]
        law_kernel(law, z, command, work)
        slot = ring[k % late]
        slot[0], slot[inner_loop.THRUST] = kind, thrust
        for i in range(3):
            slot[1 + i] = min(max(float32(command[i] / scale[i]), -bound), bound)
        advance_kernel(params, state, seed, k, sample_us, ring[(k + 1) % late], record)
