"""The loop at hover: the law as flown, sampled and delayed, on the vehicle's linear model."""

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.law.form import Law, Output
from gustproof.lti.state_space import Lti, delay, discretize_zoh, lft, series
from gustproof.model.lpv import linear_plant


def hover_plant(vehicle: Vehicle, scenario: Scenario, *, with_attitude: bool = False) -> Lti:
    """Return torque command (3,) [N*m] to gyro (3,) [rad/s] at hover, sampled and delayed as in `scenario`.

    With `with_attitude` the outputs include roll and pitch (2,) [rad], as an accelerometer on the test stand measures
    them by gravity. Unmeasured attitudes are no states; rates, actuators and delayed commands are.
    """
    full = linear_plant(vehicle)
    angles = [0, 1] if with_attitude else []
    states, outputs = [*angles, *range(3, full.order)], [3, 4, 5, *angles]
    A, C = full.A[np.ix_(states, states)], full.C[np.ix_(outputs, states)]
    system = Lti(A=A, B=full.B[states, :3], C=C, D=full.D[outputs, :3])
    plant = discretize_zoh(system, scenario.dt)
    for _ in range(scenario.delay_samples):
        plant = series(delay(3, scenario.dt), plant)
    return plant


def linear_law(law: Law, inputs: int = 3) -> Lti:
    """Return the law within its limits, linear at level attitude, from its first `inputs` inputs to the command."""
    rates = np.eye(3, law.order, 3)
    return Lti(A=law.A + law.G @ rates, B=law.B[:, :inputs], C=law.C, D=law.D[:, :inputs], dt=law.dt)


def loop_law(law: Law) -> Lti:
    """Return the law within its limits, linear at hover, from the measurements that close its loop to the command.

    These are the gyro (3,), and roll and pitch (2,) [rad] by the specific force if the law reads the accelerometer.
    """
    K = linear_law(law, inputs=law.D.shape[1])
    measured = [k for k in range(K.n_inputs) if not 3 <= k < 6]  # all but the reference
    return Lti(A=K.A, B=K.B[:, measured], C=K.C, D=K.D[:, measured], dt=K.dt)


def is_stable_at_hover(law: Law, vehicle: Vehicle, scenario: Scenario) -> bool | None:
    """Return whether the linear loop is stable; `None` for a rates law, whose loop is the autopilot's own."""
    if law.output is not Output.TORQUE:
        return None
    return lft(hover_plant(vehicle, scenario, with_attitude=law.uses_accelerometer), loop_law(law)).is_stable()
