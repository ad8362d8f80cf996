"""Robustness of a law's loop to inertia and actuator lag: mu, and the uncertain sensitivity."""

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.certify.mu.singular_value import mu
from gustproof.certify.mu.sweep import Bracket
from gustproof.law.form import Law, Matrix, Output
from gustproof.lti.state_space import Lti
from gustproof.model.lft import Uncertain, as_uncertain
from gustproof.model.sampled_axis import sampled_axis
from gustproof.model.uncertainty import Spreads


def robust_stability(law: Law, vehicle: Vehicle, scenario: Scenario, spreads: Spreads, axis: int) -> Bracket:
    """Return mu of constant inertia and lag: the axis is stable at hover up to 1 / mu times `spreads`.

    Raises
    ------
    ValueError
        Under the conditions of `uncertain_sensitivity`, or if the nominal loop is unstable.

    Examples
    --------
    >>> from gustproof import Spreads, load_law, load_scenario, load_vehicle, robust_stability
    >>> law, vehicle, scenario = load_law("pid-fair"), load_vehicle("paper"), load_scenario("paper")
    >>> found = robust_stability(law, vehicle, scenario, Spreads(inertia=0.2, actuator_lag=0.3), axis=0)
    >>> f"stable up to {1.0 / found.upper:.1f} times the spreads"
    'stable up to 1.9 times the spreads'
    """
    family = uncertain_sensitivity(law, vehicle, scenario, spreads, axis)
    known = family.M.subsystem(slice(0, family.n_z), slice(0, family.n_w))
    return mu(Uncertain(M=known, blocks=family.blocks))


def uncertain_sensitivity(law: Law, vehicle: Vehicle, scenario: Scenario, spreads: Spreads, axis: int) -> Uncertain:
    """Return the sensitivity at the plant's input of one axis, with uncertain inertia and lag.

    Raises
    ------
    ValueError
        If the law couples its axes, uses the accelerometer or commands no torque, or a spread is 0.
    """
    loop = as_uncertain(axis_controller(law, axis)) @ sampled_axis(
        vehicle, scenario, axis, inertia=spreads.inertia, actuator_lag=spreads.actuator_lag
    )
    return (np.eye(1) - loop).inverse()


def axis_controller(law: Law, axis: int) -> Lti:
    """Return the law of one axis from gyro [rad/s] to command [N*m], linear at level attitude.

    Raises
    ------
    ValueError
        If the law couples its axes, uses the accelerometer or commands no torque.
    """
    A, B = law.A + law.G @ np.eye(3, law.order, 3), law.B[:, axis]
    own, others = _reachable_states(A, B), [k for k in range(3) if k != axis]
    across = (law.C[others][:, own], law.D[others, axis], law.C[axis, ~own], law.D[axis, others])
    if law.output is not Output.TORQUE or law.uses_accelerometer or any(np.any(part) for part in across):
        raise ValueError(
            f"law '{law.name}' couples its axes, uses the accelerometer or commands no torque: no loop of one gyro"
        )
    return Lti(A=A[np.ix_(own, own)], B=B[own], C=law.C[axis, own], D=law.D[axis, axis], dt=law.dt)


def _reachable_states(A: Matrix, B: Matrix) -> NDArray[np.bool_]:
    """Return a mask of the states reachable from one input, with input matrix (n,)."""
    reached: NDArray[np.bool_] = B != 0.0
    for _ in range(len(B)):
        reached = reached | np.any(A[:, reached] != 0.0, axis=1)
    return reached
