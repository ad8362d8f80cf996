"""A scheduled law at constant parameters, and the continuous controller that it was sampled from."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import groupby, product

import numpy as np

from gustproof.law.discretize import TANGENTS
from gustproof.law.form import ANGLES, GYRO_REFERENCE_SIZE, Law, Schedule
from gustproof.law.resample import continuous_origin
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import RealBlock

_NAMES = {angle: tangent for tangent, angle in TANGENTS.items()}


def law_at(law: Law, values: Mapping[str, float]) -> Law:
    """Return a scheduled law with its parameters held at `values` [rad, rad/s], those left out at 0.

    It has no schedule. Values beyond the limits count as at them.
    """
    schedule = law.schedule
    if schedule is None:
        return law
    pairs = zip(schedule.parameters, schedule.limits.tolist(), strict=True)
    delta = [_share(name, values.get(name, 0.0), limit) for name, limit in pairs]
    Delta = np.diag(delta)
    W = np.linalg.solve(np.eye(len(delta)) - Delta @ schedule.L, Delta)
    P, Q = schedule.P @ W, schedule.Q @ W
    J, K = schedule.J, schedule.K
    return replace(law, A=law.A + Q @ J, B=law.B + Q @ K, C=law.C + P @ J, D=law.D + P @ K, schedule=None)


def schedule_limits(schedule: Schedule) -> dict[str, float]:
    """Return the limit [rad, rad/s] of each parameter."""
    return dict(zip(schedule.parameters, schedule.limits.tolist(), strict=True))


def corners(schedule: Schedule) -> Iterator[dict[str, float]]:
    """Yield the parameters [rad, rad/s] at each corner of their box."""
    limits = schedule_limits(schedule)
    for signs in product((-1.0, 1.0), repeat=len(limits)):
        yield {name: sign * limit for (name, limit), sign in zip(limits.items(), signs, strict=True)}


def continuous_controller(law: Law) -> Uncertain:
    """Return the continuous controller, gyro (3,) to command (3,), that `central_law` sampled to a scheduled law.

    Raises
    ------
    ValueError
        If the law has no schedule, also exact kinematics, a reference or an accelerometer.
    DesignError
        If it has a pole at -1: no continuous controller is sampled to it.
    """
    sampled, blocks = sampled_controller(law)
    return Uncertain(M=continuous_origin(sampled), blocks=blocks)


def sampled_controller(law: Law) -> tuple[Lti, tuple[RealBlock, ...]]:
    """Return the sampled system from parameters and gyro (3,) to parameters and command (3,), and its parameters.

    Its numbers are those of the law.

    Raises
    ------
    ValueError
        If the law has no schedule, also exact kinematics, a reference or an accelerometer.
    """
    schedule = law.schedule
    if schedule is None:
        raise ValueError(f"law '{law.name}' has no schedule")
    if law.has_kinematics or law.takes_references or law.D.shape[1] != GYRO_REFERENCE_SIZE:
        raise ValueError(f"law '{law.name}' has more than a schedule: kinematics, a reference or an accelerometer")
    pairs = list(zip(schedule.parameters, schedule.limits.tolist(), strict=True))
    order = sorted(range(len(pairs)), key=pairs.__getitem__)
    blocks = []
    for (name, limit), rows in groupby(pairs[i] for i in order):
        high = math.tan(0.5 * limit) if name in ANGLES else limit
        blocks.append(
            RealBlock(name=_NAMES.get(name, name), low=-high, high=high, nominal=0.0, repeats=len(list(rows)))
        )
    sampled = Lti(
        A=law.A,
        B=np.hstack([schedule.Q[:, order], law.B[:, :3]]),
        C=np.vstack([schedule.J[order], law.C]),
        D=np.block([[schedule.L[np.ix_(order, order)], schedule.K[order, :3]], [schedule.P[:, order], law.D[:, :3]]]),
        dt=law.dt,
    )
    return sampled, tuple(blocks)


def _share(name: str, value: float, limit: float) -> float:
    within = min(max(value, -limit), limit)
    return math.tan(0.5 * within) / math.tan(0.5 * limit) if name in ANGLES else within / limit
