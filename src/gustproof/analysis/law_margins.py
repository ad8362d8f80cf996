"""Margins of a law at hover, sampled and delayed as it flies, and its robustness to inertia and actuator lag."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.certify.mu.singular_value import mu
from gustproof.certify.mu.sweep import Bracket
from gustproof.law.form import Law, Matrix, Output
from gustproof.law.hover import hover_plant, is_stable_at_hover, loop_law
from gustproof.lti.margins import margins
from gustproof.lti.state_space import Lti
from gustproof.model.lft import Uncertain, as_uncertain
from gustproof.model.sampled_axis import sampled_axis
from gustproof.model.uncertainty import Spreads

SPREADS = Spreads(inertia=0.2, actuator_lag=0.3)
"""Spreads of the vehicle for `axis_robustness`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HoverMargins:
    """Worst margins of roll, pitch and yaw, with the loop opened at the plant's input and the other axes closed."""

    Ms: float
    """[-] largest sensitivity."""
    phase_margin_deg: float
    """[deg] least destabilising change of phase."""
    delay_margin: float
    """[s] least destabilising additional delay."""


def hover_margins(law: Law, vehicle: Vehicle, scenario: Scenario) -> HoverMargins | None:
    """Return the margins of a torque law at the sample time and delay of `scenario`; `None` for an unstable loop.

    Rate laws give `None` too: they drive the autopilot's own loop, whose margins are not those of the law.

    Examples
    --------
    >>> from gustproof import hover_margins, load_law, load_scenario, load_vehicle
    >>> found = hover_margins(load_law("pid-fair"), load_vehicle("paper"), load_scenario("paper-turbulence"))
    >>> f"Ms {found.Ms:.2f}, {found.phase_margin_deg:.0f} deg"
    'Ms 1.36, 44 deg'
    """
    if not is_stable_at_hover(law, vehicle, scenario):
        return None
    axes = margins(hover_plant(vehicle, scenario, with_attitude=law.uses_accelerometer), loop_law(law)).input
    return HoverMargins(
        Ms=max(axis.Ms for axis in axes),
        phase_margin_deg=math.degrees(min(axis.phase_margin for axis in axes)),
        delay_margin=min(axis.delay_margin for axis in axes),
    )


def axis_robustness(law: Law, vehicle: Vehicle, scenario: Scenario) -> tuple[Bracket, ...]:
    """Return mu of roll, pitch and yaw with inertia and actuator lag off by `SPREADS`: stable up to 1 / mu times that.

    The result is empty for a law other than three loops of one gyro each.
    """
    try:
        return tuple(robust_stability(law, vehicle, scenario, SPREADS, axis) for axis in range(3))
    except ValueError:
        return ()


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
