"""Sampled model of one axis with uncertain inertia and actuator lag: an exact covering, no rational fit."""

import math

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.lti.state_space import Lti, delay
from gustproof.model.lft import Uncertain, append, ureal

INVERSE_INERTIA, DECAY, CARRYOVER = "inverse inertia", "decay", "carried"


def sampled_axis(vehicle: Vehicle, scenario: Scenario, axis: int, *, inertia: float, actuator_lag: float) -> Uncertain:
    """Return torque command [N*m] to gyro [rad/s] about one axis at hover, sampled and delayed as in `scenario`.

    With the lag tau and the damping d, exactly,

        moment+ = u + alpha (moment - u),    rate+ = exp(-d dt) rate + (b u + c (moment - u)) / inertia,

    with `alpha = exp(-dt / tau)`, `b = (1 - exp(-d dt)) / d` and `c = (exp(-d dt) - alpha) / (1 / tau - d)`.

    The parameters are 1 / inertia, alpha and c. One lag fixes both alpha and c; here each has a range of its own. The
    family therefore contains every axis with inertia and lag in their ranges, and a few more. `inertia` and
    `actuator_lag` [-] are their largest relative deviations from the vehicle's values, in (0, 1).
    """
    dt, tau, J = scenario.dt, vehicle.actuator_lag, vehicle.inertia_B[axis]
    rate_decay = math.exp(-vehicle.rate_damping * dt)
    held_gain = -math.expm1(-vehicle.rate_damping * dt) / vehicle.rate_damping if vehicle.rate_damping else dt
    shares = (1.0 - actuator_lag, 1.0, 1.0 + actuator_lag)
    ranges = zip(*(_lag_coefficients(share * tau, vehicle.rate_damping, dt) for share in shares), strict=True)
    decay, carryover = (
        ureal(name, low=low, nominal=nominal, high=high)
        for name, (low, nominal, high) in zip((DECAY, CARRYOVER), ranges, strict=True)
    )
    inverse = ureal(INVERSE_INERTIA, low=1.0 / (J * (1.0 + inertia)), nominal=1.0 / J, high=1.0 / (J * (1.0 - inertia)))
    # columns: rate, moment, command
    rate, _, command = np.eye(3)[:, None]
    behind = np.array([[0.0, 1.0, -1.0]])
    next_rate = rate_decay * rate + inverse @ (held_gain * command + carryover @ behind)
    step = append(next_rate, command + decay @ behind, rate)
    plant = _system_from_step(step @ np.vstack([np.eye(3)] * 3), 2, dt)
    for _ in range(scenario.delay_samples):
        plant = plant @ delay(1, dt)
    return plant


def _lag_coefficients(tau: float, damping: float, dt: float) -> tuple[float, float]:
    """Return alpha [-] and c [s]; both grow with the lag."""
    alpha = math.exp(-dt / tau)
    return alpha, (math.exp(-damping * dt) - alpha) / (1.0 / tau - damping)


def _system_from_step(step: Uncertain, n: int, dt: float) -> Uncertain:
    """Return the system of n states for a `step` from (states, inputs) to (next states, outputs)."""
    z, w, D = step.n_z, step.n_w, step.M.D
    outputs, inputs = np.r_[:z, z + n : D.shape[0]], np.r_[:w, w + n : D.shape[1]]
    states, held = slice(z, z + n), slice(w, w + n)
    M = Lti(A=D[states, held], B=D[states, inputs], C=D[outputs, held], D=D[np.ix_(outputs, inputs)], dt=dt)
    return Uncertain(M=M, blocks=step.blocks)
