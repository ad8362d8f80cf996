"""The simulated world of an external autopilot: before its flight, and in it.

    prepare: calm air, on the ground or clamped  --release-->  calm air, held in place  --begin-->  the scenario

Its clock never stops or jumps between these, as the autopilot's estimator would not survive that. One sample of the
scenario is one exchange with the autopilot. An answer acts the scenario's `delay_samples` after its sample.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.external.readings import Readings, read_sensors
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import RotorCommand

_PREPARING_SEED = 1 << 31  # noise before a flight is not that of the flight
_OFFBOARD = Mode.OFFBOARD.value
_ROTORS_OFF = (0.0, 0.0, 0.0, 0.0)


class World:
    """A vehicle and its air: for each sample `readings`, `answer` and `advance`, until `finished`.

    With `overlaps`, `advance` comes before `answer`: the step takes an earlier answer while the autopilot works.
    `record` gets the journal record of each sample of the scenario; the time before `begin` leaves none.
    """

    def __init__(
        self, vehicle: Vehicle, scenario: Scenario, seed: int, record: Callable[[NDArray[np.float64]], None]
    ) -> None:
        self._vehicle, self._seed, self._record = vehicle, seed, record
        self._script = replace(scenario, delay_samples=0)
        calm = replace(
            load_scenario("calm"),
            translation=scenario.translation,
            altitude_m=scenario.altitude_m,
            control_rate_hz=scenario.control_rate_hz,
            physics_rate_hz=scenario.physics_rate_hz,
            initial_attitude_deg=scenario.initial_attitude_deg,
            delay_samples=0,
        )
        self._noise_seed = seed ^ _PREPARING_SEED
        self._answers: deque[tuple[int, tuple[float, ...]]] = deque([(0, _ROTORS_OFF)] * scenario.delay_samples)
        self.overlaps = scenario.delay_samples > 0
        self.loop = VehicleLoop(vehicle, calm, self._noise_seed, interactive=True)
        self.flying = False
        self._clamped = not scenario.free
        self._started_us = 0
        self._last: NDArray[np.float64] | None = None
        self._readings: Readings | None = None

    @property
    def time_us(self) -> int:
        """[us] The world's clock: never stops."""
        return self._started_us + self.loop.time_us

    @property
    def started_us(self) -> int:
        """[us] The world's clock at which the scenario began; 0 before."""
        return self._started_us

    @property
    def finished(self) -> bool:
        """True if all samples of the scenario are flown."""
        return self.flying and self.loop.finished

    def readings(self) -> Readings:
        """Return the readings at this sample; the same object until the next."""
        if self._readings is None:
            told = read_sensors(self.loop, self._noise_seed, self.time_us)
            has_fix = not self.flying or self._script.has_fix(1e-6 * self.loop.time_us)
            self._readings = told if has_fix else told._replace(has_fix=False)
        return self._readings

    def release(self) -> None:
        """Open the clamp of the test stand."""
        self._clamped = False

    def begin(self) -> None:
        """Begin the scenario with the vehicle as it is now."""
        before = self.loop
        self._started_us, self._noise_seed, self.flying = self.time_us, self._seed, True
        self.loop = VehicleLoop(self._vehicle, self._script, self._seed)
        self.loop.continue_from(before)
        self._readings = None

    def answer(self, time_us: int, rotors: Sequence[float]) -> None:
        """Take the answer to the sample at `time_us` [us]: each rotor's thrust, as a fraction of its largest."""
        self._answers.append((time_us, tuple(rotors)))

    def advance(self) -> None:
        """Step to the next sample with the answer that acts now."""
        time_us, rotors = self._answers.popleft()
        command = RotorCommand(time_us - self._started_us, rotors, self._clamped)
        self._last = self.loop.advance(command, _OFFBOARD)
        self._readings = None
        if self.flying:
            self._record(self._last)

    def record_preparation(self) -> None:
        """Record the last sample of a flight that did not begin, so that its bag can be read."""
        if self._last is None:
            self._answers.append((0, _ROTORS_OFF))
            self.advance()
        if not self.flying and self._last is not None:
            self._record(self._last)
