"""Battery: charge, voltage and thrust by hand, and what a file may say of one."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import GyroFault, Scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import GRAVITY, Battery, load_vehicle, vehicle_path
from firmware_model.errors import ConfigError
from firmware_model.physics.battery import BatteryState, battery_params, step_battery
from firmware_model.recording.journal import as_records
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import TorqueCommand

CELLS = Battery(cells=4, capacity_ah=5.0, resistance_ohm=0.02, hover_current_a=20.0)
PAPER, OCTO = (replace(load_vehicle(name), battery=CELLS) for name in ("paper", "octo"))
QUIET = Scenario(name="quiet", description="", duration_s=4.0, translation="free", gyro=GyroFault(noise=False))


def step(state: BatteryState, share: float, *, dt: float = 1.0) -> BatteryState:
    """Return the state after `dt` [s] at a share [-] of the paper's vehicle's hover thrust."""
    rotor = share * PAPER.mass * GRAVITY / 4.0
    return step_battery(battery_params(PAPER, free=True, dt=dt), state, 4.0 * rotor**1.5)


@pytest.mark.parametrize(("share", "current"), [(0.0, 0.0), (1.0, 20.0), (0.25, 2.5), (4.0, 160.0)])
def test_current_goes_with_thrust_to_the_power_1_5(share, current):
    state = step(BatteryState(), share)
    assert state.current == pytest.approx(current, rel=1e-12)
    assert state.voltage == pytest.approx(16.8 - 0.02 * current, rel=1e-12)
    assert state.sag == pytest.approx((1.0 - 0.02 * current / 16.8) ** 2, rel=1e-12)
    assert state.used == pytest.approx(current, rel=1e-12)  # for a second


def test_voltage_falls_with_charge_until_there_is_none():
    half = step(BatteryState(used=9000.0), 1.0)
    assert half.voltage == pytest.approx(4.0 * 3.9 - 0.4, rel=1e-12)
    last = step(half, 1.0, dt=450.1)
    assert (last.used, last.sag > 0.0) == (18000.0, True)
    assert step(last, 1.0).sag == 0.0


def test_no_voltage_is_negative():
    assert step(BatteryState(), 100.0)[2:] == (0.0, 0.0)


@pytest.mark.parametrize("vehicle", [PAPER, OCTO], ids=["paper", "octo"])
def test_a_flight_draws_its_current_from_the_thrusts_that_are_recorded(vehicle):
    loop, currents, rows = VehicleLoop(vehicle, QUIET, 1), [], []
    for k in range(500):
        currents.append(loop.battery.current)
        rows.append(
            loop.advance(TorqueCommand(time_us=0, torque_B=(0.1, 0.0, 0.0), throttle=0.4 + 0.001 * k), 0).copy()
        )
    thrusts = as_records(np.array(rows))["rotors"]
    hover = vehicle.mass * GRAVITY / vehicle.rotors.count
    np.testing.assert_allclose(currents, 20.0 * np.mean((thrusts / hover) ** 1.5, axis=1), rtol=1e-9)
    assert loop.battery.used_ah == pytest.approx((sum(currents) + loop.battery.current) / 250.0 / 3600.0, rel=1e-9)
    assert loop.battery.remaining == pytest.approx(1.0 - loop.battery.used_ah / 5.0, rel=1e-12)


def test_thrust_and_torque_fall_with_the_square_of_the_voltage():
    command = TorqueCommand(time_us=0, torque_B=(0.2, 0.0, 0.0), throttle=0.7)
    loop = VehicleLoop(PAPER, QUIET, 1)
    record = [as_records(loop.advance(command, 0)[None])[0].copy() for _ in range(500)][-1]
    sag = (loop.battery.voltage / 16.8) ** 2
    assert sag < 0.95
    assert record["thrust_z"][0] / record["thrust_z_command"][0] == pytest.approx(sag, abs=1e-4)
    assert record["torque_B"][0] / record["torque_command_B"][0] == pytest.approx(sag, abs=1e-4)


@pytest.mark.slow
def test_on_the_stand_no_battery_is_used():
    held = replace(QUIET, translation="held")
    assert VehicleLoop(PAPER, held, 1).battery is None
    command = TorqueCommand(time_us=0, torque_B=(0.2, 0.0, 0.0), throttle=0.7)
    with_one, without = (VehicleLoop(each, held, 1) for each in (PAPER, load_vehicle("paper")))
    for _ in range(100):
        assert with_one.advance(command, 0).tobytes() == without.advance(command, 0).tobytes()


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"cells": 0}, "greater than or equal to 1"),
        ({"cells": 15}, "less than or equal to 14"),
        ({"capacity_ah": 0.0}, "greater than 0"),
        ({"voltage_empty": 4.2}, "voltage_empty must be lower"),
    ],
)
def test_an_impossible_battery_is_refused(change, cause):
    with pytest.raises(ValueError, match=cause):
        replace(CELLS, **change)


def test_a_battery_that_cannot_lift_the_vehicle_is_refused():
    with pytest.raises(ValueError, match="the rotors must lift the weight"):
        replace(PAPER, battery=replace(CELLS, resistance_ohm=0.3))


def test_a_file_may_have_a_battery_with_spreads(tmp_path):
    table = "cells = 4\nresistance_ohm = 0.02\nhover_current_a = 20.0\n"
    spread = "capacity_ah = { nominal = 5.0, low = 4.0, high = 5.2 }\n"
    path = tmp_path / "mine.toml"
    path.write_text(f"{vehicle_path('paper').read_text()}\n[battery]\n{table}{spread}")
    assert load_vehicle(path).battery == CELLS
    drained = load_vehicle_set(path).vehicle_at({"battery.capacity_ah": -1.0})
    assert drained.battery == replace(CELLS, capacity_ah=4.0)
    path.write_text(path.read_text() + "volts = 3\n")
    with pytest.raises(ConfigError, match="volts"):
        load_vehicle(path)
