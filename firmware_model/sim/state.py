"""Constants and state of vehicle, air and on-board loops, packed into arrays for the kernels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot.attitude_loop import StabilizerState, stabilizer_params
from firmware_model.autopilot.position_loop import initial_position_state, position_params
from firmware_model.config.scenario import NoiseRotation, Scenario
from firmware_model.config.vehicle import GRAVITY, NoiseModel, Vehicle
from firmware_model.config.waveforms import RandomGusts, VonKarman
from firmware_model.exact import sin_cos
from firmware_model.numerics.compiled import compiled
from firmware_model.numerics.elementary import mixed_normals
from firmware_model.numerics.random import GUST_STREAM
from firmware_model.numerics.rotations import from_euler
from firmware_model.numerics.soa import field_offset, flatten
from firmware_model.physics.actuators import ActuatorParams
from firmware_model.physics.aerodynamics import air_params
from firmware_model.physics.battery import BatteryState, battery_params
from firmware_model.physics.disturbances import make_replay, make_waves
from firmware_model.physics.dryden import dryden_filters, dryden_spectrum
from firmware_model.physics.ground import GroundParams, ground_params, standing_height
from firmware_model.physics.gust_filters import DrydenParams, DrydenState
from firmware_model.physics.mean_wind import mean_wind_params
from firmware_model.physics.rigid_body import Body, body_params
from firmware_model.physics.rotors import ROTOR_ROWS, LossParams, RotorParams, loss_params, rotor_params
from firmware_model.physics.sensors import AccelerometerParams, GyroParams
from firmware_model.physics.von_karman import (
    CALM,
    NO_KARMAN,
    SHOWN,
    STILL,
    KarmanParams,
    KarmanState,
    karman_filters,
    show_gust,
)
from firmware_model.sim.fault_schedule import ChangingVehicle, fault_schedule, initial_plant
from firmware_model.sim.layout import (
    ACTUATORS,
    BODY,
    GROUND,
    GYRO,
    LOSS,
    ROTORS,
    X_BODY,
    X_DRYDEN,
    X_STABILIZER,
    X_VON_KARMAN,
)
from firmware_model.types import Quaternion, Vector

Array = NDArray[np.float64]
_HEALTH = ROTORS + field_offset(RotorParams, "health")
_X_ATTITUDE = X_BODY + field_offset(Body, "q_NB")


class SimState(NamedTuple):
    """Arrays of a flight for the kernels."""

    params: Array
    """(n,) constants, each NamedTuple in a row with its own units."""
    state: Array
    """(n,) body, air and on-board loops, each NamedTuple in a row with its own units; stepped by the kernels."""
    waves: Array
    """(n, WAVE) gusts and direct moments by formula, see `disturbances`; units there."""
    replay: Array
    """(samples or 0, 3 * TARGETS) replayed gusts [m/s] and direct moments [N*m], see `disturbances`."""
    changes: Array
    """(n, 3) changes by events: sample, index in the constants, value from then on."""
    mix: Array
    """(n, 3) seeds of gusts and sensors, and their factors [-], see `mixed_normals`."""
    sample_us: int
    """[us] sample time."""


class _Turbulence(NamedTuple):
    dryden: DrydenParams
    karman: KarmanParams
    factor: Array


def initial_state(vehicle: Vehicle, scenario: Scenario, seed: int, *, interactive: bool = False) -> SimState:
    """Return a vehicle at rest in the scenario's attitude and height, in trimmed hover, in stationary turbulence.

    An `interactive` one has its motors off. It stands level on the ground, or is clamped on the test stand.

    Raises
    ------
    ValueError
        If the seed is not in [0, 2^32).
    """
    common = common_start(vehicle, scenario, interactive=interactive)
    mix = np.array(noise_rows(seed, scenario.turn))
    return SimState(
        params=common.params,
        state=common.draw(mix),
        waves=make_waves(scenario),
        replay=make_replay(scenario),
        changes=common.changes,
        mix=mix,
        sample_us=scenario.sample_us,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommonStart:
    """Common start of the flights of one vehicle in one scenario; seeds and attitudes add the rest.

    To make it takes ten times as long as to draw a state with it.
    """

    params: Array
    """(n,) constants, see `SimState`."""
    still: Array
    """(n,) state in the scenario's attitude, in still air, see `SimState`."""
    changes: Array
    """(n, 3) changes by events, see `SimState`."""
    factor: Array
    """(n, n) of the covariance of the turbulence's states, see `dryden_filters`, `karman_filters`; (0, 0) in calm."""
    karman: KarmanParams
    """Filters of von Karman's turbulence."""

    def draw(self, mix: Array, attitude_deg: Vector | None = None) -> Array:
        """Return the state (n,) of a flight: in an attitude, in turbulence by its seeds and factors `mix` (n, 3).

        The attitude is the scenario's by default. See `mixed_normals`.
        """
        state = self.still.copy()
        if attitude_deg is not None:
            q_NB = _attitude(attitude_deg)
            state[_X_ATTITUDE : _X_ATTITUDE + 4] = q_NB
            state[X_STABILIZER : X_STABILIZER + 4] = q_NB
        if self.karman.acts:
            start = state[X_VON_KARMAN : X_VON_KARMAN + len(self.factor)]
            _draw_state(self.factor, mix, start)
            state[X_DRYDEN : X_DRYDEN + 8] = flatten(show_gust(self.karman, _karman_state(start)))
        elif len(self.factor):
            _draw_state(self.factor, mix, state[X_DRYDEN : X_DRYDEN + len(self.factor)])
        return state


def common_start(
    vehicle: Vehicle, scenario: Scenario, *, gust_scale: float | None = None, interactive: bool = False
) -> CommonStart:
    """Return what all flights of a vehicle in a scenario begin with; `gust_scale` replaces the scenario's."""
    gusts = _turbulence(vehicle, scenario)
    grounded = interactive and scenario.free
    still = (0.0, 0.0, 0.0)
    q_NB = _attitude(still if grounded else scenario.initial_attitude_deg)
    estimate = StabilizerState(*q_NB, *[0.0] * 9)
    height = standing_height(vehicle) if grounded else scenario.altitude_m
    thrust = 0.0 if interactive else vehicle.mass * GRAVITY
    body = Body((0.0, 0.0, -height), still, q_NB, still, still, thrust)
    scale = scenario.gust_scale if gust_scale is None else gust_scale
    return CommonStart(
        params=_pack_params(vehicle, scenario, gusts, scale),
        still=np.array(
            [
                *flatten((body, DrydenState(*[0.0] * 8), estimate)),
                *initial_position_state(),
                *flatten(STILL),
                *[0.0] * (4 + 5),  # the place to hold; load, moment, next change
                *BatteryState(),
            ]
        ),
        changes=_list_changes(vehicle, scenario),
        factor=gusts.factor,
        karman=gusts.karman,
    )


def noise_rows(seed: int, turns: Sequence[NoiseRotation]) -> list[Vector]:
    """Return the rows for `mixed_normals` of a seed and the turns of its noise.

    Raises
    ------
    ValueError
        If the seed is not in [0, 2^32).
    """
    if not 0 <= seed < 2**32:
        raise ValueError(f"seed is {seed}, must be in [0, 2^32)")
    rows = [(float(seed), 0.0, 1.0)]
    for turn in turns:
        sine, cosine = sin_cos(turn.angle_rad)
        rows.append((float(turn.seed), cosine, sine))
    return rows


def _pack_params(vehicle: Vehicle, scenario: Scenario, gusts: _Turbulence, gust_scale: float) -> Array:
    rows = (
        body_params(vehicle, scenario.physics_dt),
        gusts.dryden,
        _gyro_params(initial_plant(vehicle, scenario), scenario),
        stabilizer_params(vehicle, vehicle.stabilizer, scenario.dt),
        position_params(vehicle, vehicle.position, scenario.dt),
        LossParams(),
        air_params(vehicle),
        ground_params(vehicle),
        mean_wind_params(scenario.wind),
        ActuatorParams(),
        _accelerometer_params(vehicle, scenario),
        battery_params(vehicle, free=scenario.free, dt=scenario.dt),
        gusts.karman,
    )
    steps = scenario.physics_rate_hz // scenario.control_rate_hz
    rotors = vehicle.rotors
    weight = vehicle.mass * GRAVITY
    single = (scenario.free, steps, gust_scale, weight, rotors.total_thrust, rotors.count, scenario.holds_place)
    return np.array([*flatten(rows), *single, *flatten(rotor_params(rotors))], dtype=np.float64)


def _list_changes(vehicle: Vehicle, scenario: Scenario) -> Array:
    """Return a row (sample, index, value) for each constant that an event changes."""
    plants = list(fault_schedule(vehicle, scenario))
    if not plants:
        return np.empty((0, 3))
    rows: list[tuple[int, int, float]] = []
    before = _changeable_params(initial_plant(vehicle, scenario), scenario)
    for sample, plant in plants:
        now = _changeable_params(plant, scenario)
        rows += [(sample, at, value) for at, value in now.items() if value != before[at]]
        before = now
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _changeable_params(plant: ChangingVehicle, scenario: Scenario) -> dict[int, float]:
    """Return the constants that events may change, by index.

    Springs of the feet, hover thrust and all gains stay as built.
    """
    weight = GROUND + field_offset(GroundParams, "weight")
    body, gyro = body_params(plant.vehicle, scenario.physics_dt), _gyro_params(plant, scenario)
    rows = [(BODY, body), (GYRO, gyro), (ACTUATORS, plant.actuators), (weight, (plant.vehicle.mass * GRAVITY,))]
    rows += [(LOSS, loss_params(plant.vehicle.rotors, plant.health))]
    rows += [(_HEALTH + i * ROTOR_ROWS, (share,)) for i, share in enumerate(plant.health)]
    return {start + i: value for start, row in rows for i, value in enumerate(flatten(row))}


def _gyro_params(plant: ChangingVehicle, scenario: Scenario) -> GyroParams:
    """Return the gyro's constants; noise is stated for 250 Hz and, as a density, grows with the root of the rate."""
    instrument = plant.vehicle.gyro
    ratio = instrument.noise_ratio * math.sqrt(scenario.control_rate_hz / 250.0) * plant.noise
    constant = instrument.noise_model is NoiseModel.CONSTANT
    b_x, b_y, b_z = (b + fault for b, fault in zip(instrument.bias_B, plant.bias, strict=True))
    sigma = ratio * instrument.reference_rate if constant else 0.0
    return GyroParams(sigma, 0.0 if constant else ratio, b_x, b_y, b_z, instrument.range, *plant.drift, plant.since_s)


def _accelerometer_params(vehicle: Vehicle, scenario: Scenario) -> AccelerometerParams:
    instrument, fault = vehicle.accelerometer, scenario.accelerometer
    sigma = instrument.noise_density * math.sqrt(0.5 * scenario.control_rate_hz) if fault.noise else 0.0
    b_x, b_y, b_z = (b + extra for b, extra in zip(instrument.bias_B, fault.bias_mps2, strict=True))
    return AccelerometerParams(sigma, b_x, b_y, b_z, instrument.range)


def _turbulence(vehicle: Vehicle, scenario: Scenario) -> _Turbulence:
    turbulence = next((item for item in scenario.wind if isinstance(item, RandomGusts)), None)
    if turbulence is None:
        return _Turbulence(CALM, NO_KARMAN, np.empty((0, 0)))
    spectrum = dryden_spectrum(turbulence, scenario.altitude_m, vehicle.span)
    if isinstance(turbulence, VonKarman):
        return _Turbulence(SHOWN, *karman_filters(spectrum, vehicle.span, scenario.dt))
    params, factor = dryden_filters(spectrum, vehicle.span, scenario.dt)
    return _Turbulence(params, NO_KARMAN, factor)


def _karman_state(start: Array) -> KarmanState:
    u, v, w = start[:5].tolist(), start[5:11].tolist(), start[11:17].tolist()
    return KarmanState(tuple(u), tuple(v), tuple(w), float(start[17]))


def _attitude(attitude_deg: Vector) -> Quaternion:
    phi, theta, psi = attitude_deg
    return _from_euler(math.radians(phi), math.radians(theta), math.radians(psi))


@compiled
def _draw_state(factor: Array, mix: Array, state: Array) -> None:
    """Write stationary states (n,) of turbulence with the `factor` (n, n) of their covariance.

    Blocks 0 and 1 of sample 0 drive its step, those from 2 on are its initial state.
    """
    state[:] = 0.0
    for block in range((factor.shape[1] + 3) // 4):
        drawn = mixed_normals(mix, GUST_STREAM, 0, 2 + block)
        for k in range(min(4, factor.shape[1] - 4 * block)):
            for i in range(factor.shape[0]):
                state[i] += factor[i, 4 * block + k] * drawn[k]


@compiled
def _from_euler(phi: float, theta: float, psi: float) -> Quaternion:
    return from_euler(phi, theta, psi)
