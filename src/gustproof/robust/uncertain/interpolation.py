"""Stable systems with a given complex value at one frequency."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, gain, series
from gustproof.robust.uncertain.uncertainty import Delta, DeltaBlock, FullBlock


def interpolate_blocks(blocks: tuple[DeltaBlock, ...], delta: Delta, omega: float, dt: float) -> Mapping[str, Any]:
    """Return a Delta with each complex value replaced by a stable system that has it at `omega` [rad/s]."""
    full = {block.name for block in blocks if isinstance(block, FullBlock)} & set(delta)
    systems = {name: interpolate_block(np.atleast_2d(np.asarray(delta[name])), omega, dt) for name in full}
    return {**delta, **systems}


def interpolate_block(value: ComplexMatrix, omega: float, dt: float) -> Lti:
    """Return a stable system of the norm of the complex matrix `value`, and its leading rank-one part at `omega`.

    Each entry of the leading singular vectors is an all-pass of first order with the entry's phase.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, theorem 9.1 (construction).
    """
    U, sizes, Vh = np.linalg.svd(value)
    warped = 2.0 / dt * np.tan(0.5 * omega * dt) if dt else omega
    left, right = _all_passes(U[:, 0], warped), _all_passes(Vh[0], warped)
    # the channels of `right` are summed, and drive all of `left`
    joint = gain(sizes[0] * np.ones(value.shape))
    system = series(series(right, joint), left)
    return tustin(system, dt) if dt and system.order else replace(system, dt=dt)


def _all_passes(vector: ComplexMatrix, omega: float) -> Lti:
    """Return diagonal `size sign (s - a) / (s + a)` with the entries of `vector` at `omega` [rad/s]."""
    poles, levels = [], []
    for entry in vector:
        phase = float(np.angle(entry))
        level = abs(entry) if phase > 0.0 else -abs(entry)
        turn = phase if phase > 0.0 else phase + np.pi  # of (j omega - a) / (j omega + a), in (0, pi]
        poles.append(max(omega, 1e-6) * np.tan(0.5 * turn) if turn < np.pi - 1e-6 else 0.0)
        levels.append(level if poles[-1] else np.real(entry))
    a, level = np.array(poles), np.array(levels)
    kept = np.nonzero(a)[0]
    pick = np.eye(a.size)[kept]
    # (s - a) / (s + a) = 1 - 2 a / (s + a)
    return Lti(A=-np.diag(a[kept]), B=pick, C=(-2.0 * a * level * pick).T, D=np.diag(level))
