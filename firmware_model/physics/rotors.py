"""Allocate torques and thrust to rotors, within their limits, and let rotors fail.

Rotor i at `position_B` gives the thrust T_i within 0..`thrust_max` along -z of B, and the drag torque
`spin * drag_ratio * T_i` about z:

    roll = -sum y_i T_i    pitch = sum x_i T_i    yaw = drag_ratio sum spin_i T_i    thrust = sum T_i

For four rotors the inverse is exact, for more it has the least sum of squares. A rotor that turns counter-clockwise,
seen from above, turns the nose to the right: spin 1.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from firmware_model.config.vehicle import Rotors
from firmware_model.exact import multiply
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.soa import Lane, loader, put
from firmware_model.physics.rigid_body import Wrench
from firmware_model.types import Vector

Float4 = tuple[float, float, float, float]


class RotorParams(NamedTuple):
    """One rotor's share of a wrench, and its limit.

    It gives its `share` of the thrust. A torque acts on it like `roll` (`pitch`, `yaw`) times that in thrust.
    """

    share: float
    """[-] of the thrust."""
    reach: float
    """[N] collective thrust that takes the rotor to its limit without torques."""
    roll: float
    """[1/m] thrust per torque."""
    pitch: float
    """[1/m] thrust per torque."""
    yaw: float
    """[1/m] thrust per torque."""
    health: float
    """[-] thrust that it gives, of what it is to give: 1 is sound, 0 is dead."""


class LossParams(NamedTuple):
    """Wrench that failed rotors don't give, per wrench of sound ones; torques [N*m], thrust [N]."""

    failed: float = 0.0
    """[-] 1 if any rotor has failed, else 0."""
    roll: Float4 = (0.0, 0.0, 0.0, 0.0)
    """[N*m] per roll, pitch, yaw, thrust."""
    pitch: Float4 = (0.0, 0.0, 0.0, 0.0)
    """[N*m] per roll, pitch, yaw, thrust."""
    yaw: Float4 = (0.0, 0.0, 0.0, 0.0)
    """[N*m] per roll, pitch, yaw, thrust."""
    thrust: Float4 = (0.0, 0.0, 0.0, 0.0)
    """[N] per roll, pitch, yaw, thrust."""


ROTOR_ROWS = len(RotorParams._fields)
"""Numbers of a rotor in the packed constants."""
_load_rotor = loader(RotorParams)


@lru_cache(maxsize=64)
def rotor_params(rotors: Rotors) -> tuple[RotorParams, ...]:
    """Return the shares of each rotor, all sound."""
    inverse = rotors.allocation
    share = inverse[:, 3]
    rows = (share, rotors.thrust_max / share, *(inverse[:, :3].T / share), np.ones(rotors.count))
    return tuple(RotorParams(*row) for row in np.array(rows).T.tolist())


def loss_params(rotors: Rotors, health: tuple[float, ...]) -> LossParams:
    """Return what is lost if each rotor gives its `health` [-], 0 to 1, of its thrust."""
    if all(share == 1.0 for share in health):
        return LossParams()
    lost = multiply(rotors.wrench * (1.0 - np.array(health)), rotors.allocation)
    return LossParams(1.0, *(tuple(row) for row in lost.tolist()))


def can_hover(rotors: Rotors, health: tuple[float, ...], weight: float) -> bool:
    """Return whether the allocation can carry a weight [N] level and still, with each rotor within its limits.

    It knows of no failure: rotors of `health` [-] 0 to 1 are commanded to give all. A rotor at a limit can only move
    away from it, which is no control.
    """
    given = rotors.wrench * np.array(health) @ rotors.allocation
    if np.linalg.cond(given) > 1e9:
        return False
    thrusts = rotors.allocation @ np.linalg.solve(given, (0.0, 0.0, 0.0, weight))
    return bool(thrusts.min() > 1e-6 * weight and thrusts.max() < rotors.thrust_max)


@kernel
def _tilt(rotor: RotorParams, L: float, M: float) -> float:
    return rotor.roll * L + rotor.pitch * M


def _make_allocation(constant: int = 0) -> Callable[[Lane, int, int, Vector, float], tuple[Vector, float]]:
    """Return the kernel of `allocate`, for a `constant` number of rotors if not 0: loops over it become SIMD."""

    @kernel
    def allocate(params: Lane, row: int, count: int, torque_B: Vector, thrust: float) -> tuple[Vector, float]:
        count = constant or count
        L, M, N = torque_B
        first = _load_rotor(params, row)
        # In collective thrust: rotor i stops at -scale * tilt[i], and is at its limit reach[i] above that.
        least = _tilt(first, L, M)
        for i in range(1, count):
            least = min(least, _tilt(_load_rotor(params, row + i * ROTOR_ROWS), L, M))
        scale = 1.0
        for i in range(count):
            rotor = _load_rotor(params, row + i * ROTOR_ROWS)
            over = _tilt(rotor, L, M) - least
            if scale * over > rotor.reach:
                scale = rotor.reach / over
        high = first.reach - scale * _tilt(first, L, M)
        for i in range(1, count):
            rotor = _load_rotor(params, row + i * ROTOR_ROWS)
            high = min(high, rotor.reach - scale * _tilt(rotor, L, M))
        collective = max(min(thrust, high), -scale * least)
        yaw = 1.0
        for i in range(count):
            rotor = _load_rotor(params, row + i * ROTOR_ROWS)
            used, yaw_share = scale * _tilt(rotor, L, M) + collective, rotor.yaw * N
            room = rotor.reach - used if yaw_share > 0.0 else used
            if yaw * abs(yaw_share) > room:
                yaw = max(room, 0.0) / abs(yaw_share)
        return (scale * L, scale * M, yaw * N), collective

    return allocate


_allocate_four, _allocate_any = _make_allocation(4), _make_allocation()


@kernel
def allocate(params: Lane, row: int, count: int, torque_B: Vector, thrust: float) -> tuple[Vector, float]:
    """Return the torques [N*m] B and the thrust [N] that `count` rotors, packed from `row` on, can give of a demand.

    No rotor leaves 0..`thrust_max`. Where the demand is too much, roll and pitch come first, both scaled by one factor
    if they alone exceed the limits. The thrust then moves to the nearest value that leaves room for them, and yaw gets
    the rest. Each stage ignores the later ones, as in PX4: a yaw that would make room for tilt is not counted on. Nor
    are combinations of more than four rotors that give no wrench.
    """
    if count == 4:
        return _allocate_four(params, row, count, torque_B, thrust)
    return _allocate_any(params, row, count, torque_B, thrust)


@kernel
def can_give(params: Lane, row: int, count: int, torque_B: Vector, thrust: float) -> bool:
    """Return whether `allocate` gives a demand unchanged, by its comparisons; its divisions are for other demands."""
    L, M, N = torque_B
    least = _tilt(_load_rotor(params, row), L, M)
    for i in range(1, count):
        least = min(least, _tilt(_load_rotor(params, row + i * ROTOR_ROWS), L, M))
    gives = thrust > -least
    for i in range(count):
        rotor = _load_rotor(params, row + i * ROTOR_ROWS)
        tilt, yaw_share = _tilt(rotor, L, M), rotor.yaw * N
        used = tilt + thrust
        room = rotor.reach - used if yaw_share > 0.0 else used
        gives &= (tilt - least <= rotor.reach) & (thrust < rotor.reach - tilt) & (abs(yaw_share) <= room)
    return gives


@kernel
def _rotor_thrust(rotor: RotorParams, torque_B: Vector, thrust: float) -> float:
    L, M, N = torque_B
    return rotor.health * (rotor.share * (rotor.roll * L + rotor.pitch * M + rotor.yaw * N + thrust))


@kernel
def put_rotor_thrusts(
    params: Lane, row: int, count: int, torque_B: Vector, thrust: float, record: Lane, at: int
) -> None:
    """Write to `record`, from `at` on, the thrust [N] of each rotor; the wrench [N*m] B, [N] is of sound ones."""
    if count == 4:
        for i in range(4):
            put(record, at + i, _rotor_thrust(_load_rotor(params, row + i * ROTOR_ROWS), torque_B, thrust))
    else:
        for i in range(count):
            put(record, at + i, _rotor_thrust(_load_rotor(params, row + i * ROTOR_ROWS), torque_B, thrust))


@kernel
def sum_lift(params: Lane, row: int, count: int, torque_B: Vector, thrust: float) -> float:
    """Return the sum [N^1.5] of each rotor's thrust to the power 1.5; the wrench [N*m] B, [N] is of sound ones."""
    total = 0.0
    for i in range(count):
        given = max(_rotor_thrust(_load_rotor(params, row + i * ROTOR_ROWS), torque_B, thrust), 0.0)
        total += given * math.sqrt(given)
    return total


@kernel
def _dot(row: Float4, torque_B: Vector, thrust: float) -> float:
    return row[0] * torque_B[0] + row[1] * torque_B[1] + row[2] * torque_B[2] + row[3] * thrust


@kernel
def given_by_rotors(params: LossParams, asked: Wrench) -> Wrench:
    """Return what the rotors, sound or failed, give where sound ones give a wrench."""
    if params.failed == 0.0:
        return asked
    (roll, pitch, yaw), thrust = asked
    L, M = _dot(params.roll, asked.torque_B, thrust), _dot(params.pitch, asked.torque_B, thrust)
    N, lift = _dot(params.yaw, asked.torque_B, thrust), _dot(params.thrust, asked.torque_B, thrust)
    return Wrench((roll - L, pitch - M, yaw - N), thrust - lift)
