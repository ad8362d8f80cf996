"""Battery with an internal resistance, whose voltage costs thrust.

V. H. Johnson, Battery performance models in ADVISOR, Journal of Power Sources 110, 2002, the R_int model: the terminal
voltage is the open-circuit voltage less resistance times current. Here the open-circuit voltage falls in proportion to
the charge used. By momentum theory (J. G. Leishman, Principles of Helicopter Aerodynamics, chapter 2) a rotor's power
goes with its thrust to the power 1.5. So does the current here, for the voltage changes little against it. A motor's
speed at a given command goes with the voltage, thrust with the square of speed: thrust and torques with its square.
"""

from typing import NamedTuple

import numpy as np

from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.numerics.compiled import kernel


class BatteryParams(NamedTuple):
    """Constants of a battery; by default there is none, and nothing is drawn."""

    present: float = 0.0
    """[-] 1 if there is a battery, else 0."""
    draw: float = 0.0
    """[A/N^1.5] current per sum of the rotors' thrusts, each to the power 1.5."""
    dt: float = 0.0
    """[s] sample time."""
    capacity: float = 1.0
    """[C] charge."""
    voltage_full: float = 1.0
    """[V] of all cells, without current."""
    voltage_fall: float = 0.0
    """[V] from full to empty."""
    resistance: float = 0.0
    """[ohm] of all cells and wires."""


class BatteryState(NamedTuple):
    """Charge, current and voltage."""

    used: float = 0.0
    """[C] charge drawn."""
    current: float = 0.0
    """[A]."""
    voltage: float = 1.0
    """[V] of all cells, under the current."""
    sag: float = 1.0
    """[-] thrust and torques that the rotors give, of those that the command gives at the full battery's voltage."""


def battery_params(vehicle: Vehicle, *, free: bool, dt: float) -> BatteryParams:
    """Return the constants of a vehicle's battery for samples of `dt` [s]; of none on the test stand, if not `free`."""
    battery = vehicle.battery
    if battery is None or not free:
        return BatteryParams()
    hover = vehicle.rotors.allocation[:, 3] * vehicle.mass * GRAVITY
    return BatteryParams(
        present=1.0,
        draw=battery.hover_current_a / float(np.sum(hover**1.5)),
        dt=dt,
        capacity=3600.0 * battery.capacity_ah,
        voltage_full=battery.cells * battery.voltage_full,
        voltage_fall=battery.cells * (battery.voltage_full - battery.voltage_empty),
        resistance=battery.resistance_ohm,
    )


@kernel
def step_battery(params: BatteryParams, state: BatteryState, lift: float) -> BatteryState:
    """Return the state at a sample, and the charge drawn up to the next; `lift` [N^1.5] is the sum of thrust^1.5.

    A battery without charge is cut off: the rotors then give nothing.
    """
    current = params.draw * lift
    open_circuit = params.voltage_full - params.voltage_fall * (state.used / params.capacity)
    voltage = max(open_circuit - params.resistance * current, 0.0)
    level = voltage / params.voltage_full
    sag = level * level if state.used < params.capacity else 0.0
    return BatteryState(min(state.used + current * params.dt, params.capacity), current, voltage, sag)
