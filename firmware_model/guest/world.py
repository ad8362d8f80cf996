"""The simulated world of a guest autopilot: before its flight, and in it.

    prepare: calm air, on the ground or clamped  --begin-->  the scenario, from t = 0 to its end

Its clock never stops or jumps between the two, as the guest's estimator would not survive that. One sample of the
scenario is one exchange with the guest.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.guest.readings import Readings, read_sensors
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import RotorCommand

_PREPARING_SEED = 1 << 31  # noise before a flight is not that of the flight


class World:
    """A vehicle and its air, stepped by rotor commands: `readings`, then `advance`, until `finished`.

    `record` gets the journal record of each sample of the scenario; the time before `begin` leaves none.
    """

    def __init__(
        self, vehicle: Vehicle, scenario: Scenario, seed: int, record: Callable[[NDArray[np.float64]], None]
    ) -> None:
        self._vehicle, self._scenario, self._seed, self._record = vehicle, scenario, seed, record
        calm = replace(
            load_scenario("calm"),
            translation=scenario.translation,
            altitude_m=scenario.altitude_m,
            control_rate_hz=scenario.control_rate_hz,
            physics_rate_hz=scenario.physics_rate_hz,
        )
        self._noise_seed = seed ^ _PREPARING_SEED
        self.loop = VehicleLoop(vehicle, calm, self._noise_seed, interactive=True)
        self.flying = False
        self._started_us = 0

    @property
    def time_us(self) -> int:
        """[us] The world's clock: never stops."""
        return self._started_us + self.loop.time_us

    @property
    def finished(self) -> bool:
        """True if all samples of the scenario are flown."""
        return self.flying and self.loop.finished

    def readings(self) -> Readings:
        """Return the readings at this sample."""
        return read_sensors(self.loop, self._noise_seed, self.time_us)

    def begin(self) -> None:
        """Begin the scenario with the vehicle as it is now."""
        before = self.loop
        self._started_us, self._noise_seed, self.flying = self.time_us, self._seed, True
        self.loop = VehicleLoop(self._vehicle, self._scenario, self._seed)
        self.loop.continue_from(before)

    def advance(self, rotors: Sequence[float]) -> None:
        """Step to the next sample with each rotor's thrust, as a fraction of its largest."""
        held_still = not self.flying and not self._scenario.free
        record = self.loop.advance(RotorCommand(self.loop.time_us, tuple(rotors), held_still), Mode.OFFBOARD.value)
        if self.flying:
            self._record(record)
