"""Events of a flight that make its figures doubtful: a vehicle upside down, a gyro at its range, a divergence."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.recording.journal import record_blocks
from firmware_model.sim.fault_schedule import fault_schedule
from gustproof.types import Records

_Flags = NDArray[np.bool_]

_RK4_LIMIT = 2.0 * math.sqrt(2.0)
"""[-] Largest rate times step at which the classical Runge-Kutta method does not amplify a rotation.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, chapter IV.2, figure 2.1: the stability region meets
the imaginary axis at 2 sqrt 2.
"""


def describe_upsets(records: Records, scenario: Scenario, vehicle: Vehicle) -> tuple[str, ...]:
    """Return a line for each upset in the records (n,) of a flight.

    Examples
    --------
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle
    >>> scenario, vehicle = load_scenario("gust-roll"), load_vehicle("paper")
    >>> describe_upsets(fly_direct(scenario, load_law("hinf-d1"), vehicle=vehicle), scenario, vehicle)
    ()
    """
    lines = []
    if (tilted_s := first_tilt_s(records)) is not None:
        lines.append(f"tilted past 90 deg at {tilted_s:.1f} s")
    if clipped_s := gyro_at_range_s(records, scenario, vehicle):
        lines.append(f"gyro at its range for {clipped_s:.3g} s")
    return tuple(lines)


def first_tilt_s(records: Records) -> float | None:
    """Return the first time [s] with the rotors pointing below the horizon; `None` without one."""

    def is_tilted(block: Records) -> _Flags:
        _, x, y, _ = block["q_NB"].T
        return np.asarray(1.0 - 2.0 * (x * x + y * y) < 0.0)

    return _first_s(records, is_tilted)


def gyro_at_range_s(records: Records, scenario: Scenario, vehicle: Vehicle) -> float:
    """Return the time [s] with a measured rate at the gyro's range, on any axis."""
    schedule, done, count = fault_schedule(vehicle, scenario), 0, 0
    for block in record_blocks(records):
        limits = np.full(len(block), vehicle.gyro.range)
        for sample, plant in schedule:
            limits[max(sample - done, 0) :] = plant.vehicle.gyro.range
        at_range = np.abs(block["gyro_B"]) >= limits.astype(np.float32)[:, None]
        count, done = count + int(np.count_nonzero(at_range.any(axis=1))), done + len(block)
    return float(count * scenario.dt)


def divergence_s(records: Records, scenario: Scenario) -> float | None:
    """Return the first time [s] at which a flight's records are beyond the simulation; `None` if they never are.

    They are where the attitude, a rate, the velocity or the position is no finite number, or a rate is faster than the
    physics steps can follow.
    """
    fastest = _RK4_LIMIT * scenario.physics_rate_hz

    def is_beyond(block: Records) -> _Flags:
        state = np.column_stack([block[name] for name in ("q_NB", "omega_B", "velocity_N", "position_N")])
        with np.errstate(invalid="ignore"):
            return np.asarray(~np.isfinite(state).all(axis=1) | (np.abs(block["omega_B"]) > fastest).any(axis=1))

    return _first_s(records, is_beyond)


def _first_s(records: Records, is_so: Callable[[Records], _Flags]) -> float | None:
    for block in record_blocks(records):
        if len(found := np.flatnonzero(is_so(block))):
            return float(block["time_us"][found[0]] * 1e-6)
    return None
