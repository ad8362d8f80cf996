"""Plant and on-board loops at their rates: the one place that delays commands and packs them as set-points."""

import math
import signal
from collections.abc import Sequence
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot.attitude_loop import stabilizer_params
from firmware_model.autopilot.modes import Mode
from firmware_model.autopilot.position_loop import position_params
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import GRAVITY, PositionLoop, Stabilizer, Vehicle
from firmware_model.numerics.compiled import compiled, find_cache
from firmware_model.numerics.soa import field_offset
from firmware_model.physics.battery import BatteryState
from firmware_model.physics.rigid_body import Body
from firmware_model.recording.journal import FORCE_B, GYRO_B, WIDTH, record_type
from firmware_model.sim import inner_loop, step
from firmware_model.sim.layout import (
    GUST_SCALE,
    LOSS,
    POSITION,
    STABILIZER,
    X_BATTERY,
    X_BODY,
    X_DRYDEN,
    X_LOAD,
    X_POSITION,
    X_STABILIZER,
    X_TILT_DEG,
)
from firmware_model.sim.state import SimState, initial_state
from firmware_model.types import (
    AttitudeTarget,
    BatteryReading,
    ImuSample,
    LevelFlight,
    PositionTarget,
    Quaternion,
    RotorCommand,
    Setpoint,
    TorqueCommand,
    Trim,
    Vector,
)

Array = NDArray[np.float64]
_AGE, _MODE = WIDTH - 2, WIDTH - 1
_IMU = slice(GYRO_B, FORCE_B + 3)  # gyro and specific force are neighbours
_UNUSED_FIELDS = (math.nan,) * (inner_loop.SETPOINT_WIDTH - 1)
_TRIM = np.array((inner_loop.TRIM, *_UNUSED_FIELDS))
_LEVEL = np.array((inner_loop.LEVEL, *_UNUSED_FIELDS))
_OFF = np.array((inner_loop.OFF, *_UNUSED_FIELDS))
_GROUND_LOAD_SHARE = 0.1  # [-] of the weight on the ground, above which the vehicle is on it


def is_cold() -> bool:
    """Return whether the first step still has to be compiled, once after an installation."""
    found = find_cache(step.advance)
    return found is not None and not found.warm


def load_step(vehicle: Vehicle, scenario: Scenario, seed: int) -> None:
    """Load the machine code of a step; compile it in two processes, as numba uses one core."""
    loop = VehicleLoop(vehicle, scenario, seed)
    if is_cold():
        other = get_context("fork").Process(target=_advance_unobserved, args=(loop,), daemon=True)
        other.start()
        loop.observe()
        other.join()
    loop.advance(LevelFlight(), Mode.STABILIZED.value)


def _advance_unobserved(loop: "VehicleLoop") -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # ends with the process that waits for it
    loop._measured = True
    loop.advance(LevelFlight(), Mode.STABILIZED.value)


class LoopArrays(NamedTuple):
    """Arrays of a vehicle at a sample."""

    sim: SimState
    """Simulation."""
    setpoints: Array
    """(delay + 1, SETPOINT_WIDTH) latest set-points, see `firmware_model.sim.inner_loop`, units there."""
    stamps_us: Array
    """(delay + 1,) [us] their stamps, or NaN; that of sample k stands at k modulo delay + 1."""
    record: Array
    """(numbers,) the sample's record, see `firmware_model.recording.journal`, units there."""


class VehicleLoop:
    """A vehicle that flies a scenario sample by sample: `observe`, then `advance`, until `finished`.

    `sample` is the number of the current one, `time_us` [us] its model time. An `interactive` vehicle begins with its
    motors off, on the ground or clamped on the stand, and never finishes. Any other begins in trimmed hover.
    """

    def __init__(self, vehicle: Vehicle, scenario: Scenario, seed: int, *, interactive: bool = False) -> None:
        self._sim = initial_state(vehicle, scenario, seed, interactive=interactive)
        self._vehicle, self._gust_scale, self._dt = vehicle, scenario.gust_scale, scenario.dt
        self._holds_place = scenario.holds_place
        self._free, self._interactive, self._clamped = scenario.free, interactive, interactive
        self._thrust_max, self.rotor_count = vehicle.rotors.total_thrust, vehicle.rotors.count
        self._torque_limit = np.array(vehicle.torque_limit)
        self._wrench = vehicle.rotors.wrench * vehicle.rotors.thrust_max
        self._on_ground_load = _GROUND_LOAD_SHARE * vehicle.mass * GRAVITY
        self._battery = vehicle.battery if scenario.free else None
        self._sample_us, self._samples = scenario.sample_us, scenario.samples
        record = record_type(self.rotor_count)
        self._record = np.full(record.itemsize // 8, math.nan)
        self._fields = self._record.view(record)[0]
        self._imu: ImuSample | None = None
        self._measured = False
        self._rows = np.tile(_TRIM, (scenario.delay_samples + 1, 1))
        self._stamps_us = np.full(scenario.delay_samples + 1, math.nan)
        self.sample = 0
        self.time_us = 0

    @property
    def finished(self) -> bool:
        """True if all samples of the scenario are flown."""
        return self.sample >= self._samples and not self._interactive

    def observe(self) -> ImuSample:
        """Return the measurements at this sample; the same object until `advance`."""
        if self._imu is None:
            self._measure()
            p, q, r, f_x, f_y, f_z = self._record[_IMU].tolist()
            self._imu = ImuSample(self.time_us, (p, q, r), (f_x, f_y, f_z), self._tilt_deg())
        return self._imu

    def _tilt_deg(self) -> tuple[float, float] | None:
        """Return roll and pitch [deg] that hold the place, if it is held."""
        if not self._holds_place:
            return None
        roll, pitch = self._sim.state[X_TILT_DEG : X_TILT_DEG + 2].tolist()
        return roll, pitch

    def advance(self, setpoint: Setpoint, mode: int) -> Array:
        """Step to the next sample and return the journal record (numbers,) of this one, valid until the next call.

        A controller's command, and the trim before the first one, act `delay_samples` later. The autopilot's own
        set-points act at once and drop the commands still on their way.

        The recorded age is that of the acting command by its stamp, `delay_samples` if it came in time. It counts whole
        samples, so the whole milliseconds of an attitude target's stamp do not show.
        """
        self._measure()
        row = self._pack_rotors(setpoint) if isinstance(setpoint, RotorCommand) else pack_setpoint(setpoint)
        stamp_us = setpoint.time_us if isinstance(setpoint, (RotorCommand, TorqueCommand, AttitudeTarget)) else None
        rows, stamps, late = self._rows, self._stamps_us, len(self._rows)
        if stamp_us is not None or isinstance(setpoint, Trim):
            rows[self.sample % late], stamps[self.sample % late] = row, math.nan if stamp_us is None else stamp_us
            self._clamped = isinstance(setpoint, RotorCommand) and setpoint.clamped
        else:
            rows[:], stamps[:] = row, math.nan
            self._clamped = row is _OFF
        acting = (self.sample + 1) % late
        step.advance(self._sim, self.sample, rows[acting], self._record)
        self._record[_AGE] = (self.time_us - stamps[acting]) // self._sample_us
        self._record[_MODE] = mode
        self.sample += 1
        self.time_us += self._sample_us
        self._imu, self._measured = None, False
        return self._record

    def arrays(self) -> LoopArrays:
        """Return the arrays of a measured sample, for kernels that fly on from it; `continue_after` follows."""
        self._measure()
        return LoopArrays(self._sim, self._rows, self._stamps_us, self._record)

    def continue_after(self, samples: int) -> None:
        """Go on after a number of samples that kernels have flown on commands of a controller."""
        self.sample += samples
        self.time_us += samples * self._sample_us
        self._imu, self._measured, self._clamped = None, True, False

    @property
    def q_NB(self) -> Quaternion:
        """True attitude at the sample."""
        w, x, y, z = self._fields["q_NB"].tolist()
        return w, x, y, z

    @property
    def estimate_q_NB(self) -> Quaternion:
        """On-board strapdown attitude at the sample."""
        w, x, y, z = step.estimate_q_NB(self._sim.state).tolist()
        return w, x, y, z

    @property
    def on_ground(self) -> bool:
        """True if the ground carries a tenth of the weight at the sample, or the vehicle is clamped on the stand."""
        self._measure()
        return bool(self._sim.state[X_LOAD] >= self._on_ground_load) if self._free else self._clamped

    @property
    def battery(self) -> BatteryReading | None:
        """Battery at the sample; `None` if there is none, or on the stand, where none is used."""
        if self._battery is None:
            return None
        self._measure()
        used, current, voltage, _ = BatteryState(*self._sim.state[X_BATTERY:].tolist())
        used_ah = used / 3600.0
        return BatteryReading(self._battery.cells, voltage, current, used_ah, 1.0 - used_ah / self._battery.capacity_ah)

    @property
    def thrust(self) -> float:
        """[-] Collective thrust at the sample, as a fraction of the largest."""
        return -float(self._fields["thrust_z"][0]) / self._thrust_max

    @property
    def torque_command(self) -> Vector:
        """[-] B, torque commanded at the sample before, as a fraction of `torque_limit`."""
        roll, pitch, yaw = (self._fields["torque_command_B"] / self._torque_limit).tolist()
        return roll, pitch, yaw

    @property
    def rotors(self) -> tuple[float, ...]:
        """[-] Thrust of each rotor at the sample, as a fraction of its largest."""
        return tuple((self._fields["rotors"] * (self.rotor_count / self._thrust_max)).tolist())

    def continue_from(self, earlier: "VehicleLoop") -> None:
        """Take over the body and the on-board estimate of a flight before this one; air and time are one's own."""
        self._sim.state[X_BODY:X_DRYDEN] = earlier._sim.state[X_BODY:X_DRYDEN]
        self._sim.state[X_STABILIZER:X_POSITION] = earlier._sim.state[X_STABILIZER:X_POSITION]

    def settle_rotors(self, rotors: Sequence[float], omega_B: Vector) -> None:
        """Give the vehicle rotors that have settled at thrusts, as fractions of the largest, and rates [rad/s] B."""
        body = self._sim.state[X_BODY:X_DRYDEN]
        body[field_offset(Body, "omega_B") :] = (*omega_B, *self._add_rotors(rotors))

    def set_gust_scale(self, scale: float) -> None:
        """Scale all gusts from the next sample on by `scale` [-], on top of the scenario's; the mean wind stays."""
        self._sim.params[GUST_SCALE] = self._gust_scale * scale

    def set_stabilizer(self, gains: Stabilizer) -> None:
        """Change the gains of the on-board attitude and rate loops."""
        self._sim.params[STABILIZER:POSITION] = stabilizer_params(self._vehicle, gains, self._dt)

    def set_position_loop(self, gains: PositionLoop) -> None:
        """Change gains and limits of the on-board height and position loops."""
        self._sim.params[POSITION:LOSS] = position_params(self._vehicle, gains, self._dt)

    def record(self) -> Array:
        """Return the journal record (numbers,) of the sample: truth, inputs and measurements; valid until `advance`."""
        self._measure()
        return self._record

    def true_vector(self, name: str) -> Vector:
        """Return a vector of the journal's record at the sample by its name, such as `omega_B` or `gust_B`."""
        a, b, c = self._fields[name].tolist()
        return a, b, c

    def _measure(self) -> None:
        if not self._measured:
            self._measured = True
            step.observe(self._sim, self.sample, self._record)

    def _pack_rotors(self, command: RotorCommand) -> Array:
        row = np.zeros(inner_loop.SETPOINT_WIDTH)
        row[0], row[inner_loop.CLAMPED] = inner_loop.WRENCH, command.clamped
        row[1:5] = self._add_rotors(command.rotors)
        return row

    def _add_rotors(self, rotors: Sequence[float]) -> Array:
        wrench = np.empty(4)
        _multiply_vector(self._wrench, np.array(rotors), wrench)
        return wrench


def pack_setpoint(setpoint: Setpoint) -> Array:
    """Return a set-point as the row (SETPOINT_WIDTH,) that the kernels take."""
    if isinstance(setpoint, TorqueCommand):
        throttle = math.nan if setpoint.throttle is None else setpoint.throttle
        return np.array((inner_loop.TORQUE, *setpoint.torque_B, 0.0, 0.0, 0.0, 0.0, throttle))
    if isinstance(setpoint, AttitudeTarget):
        return _pack_attitude_target(setpoint)
    if isinstance(setpoint, PositionTarget):
        v_down = math.nan if setpoint.v_down is None else setpoint.v_down
        return np.array((inner_loop.POSITION_TARGET, *setpoint.position_N, setpoint.yaw, v_down, 0.0, 0.0, math.nan))
    return _LEVEL if isinstance(setpoint, LevelFlight) else _TRIM if isinstance(setpoint, Trim) else _OFF


def _pack_attitude_target(target: AttitudeTarget) -> Array:
    rates = target.omega_B or (0.0, 0.0, 0.0)
    thrust = math.nan if target.thrust is None else target.thrust
    if target.q_NB is None:
        return np.array((inner_loop.RATES, *rates, 0.0, 0.0, 0.0, 0.0, thrust))
    return np.array((inner_loop.ATTITUDE, *target.q_NB, *rates, thrust))


@compiled
def _multiply_vector(matrix: Array, vector: Array, product: Array) -> None:
    """Write `matrix` (m, n) times `vector` (n,) to `product` (m,); BLAS would add in an order of the processor's."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        product[i] = total
