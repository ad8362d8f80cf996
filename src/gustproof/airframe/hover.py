"""The loop at hover: the law as flown, sampled and delayed, on the vehicle's linear model."""

import numpy as np

from firmware_model.config.link_faults import Jitter, LinkDelay
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.lpv import linear_plant
from gustproof.law.form import Law, Output
from gustproof.robust.lti.state_space import Lti, delay, discretize_zoh, lft, series


def link_delay_samples(scenario: Scenario) -> tuple[int, int]:
    """Return the samples by which the link delays each command for the whole flight, and at most at any time.

    The link delays a loop by its way there and its way back together, in whole samples. The largest delay adds those
    that act for a while, and jitter at its most.
    """
    late = [fault for fault in scenario.link if isinstance(fault, LinkDelay | Jitter)]
    always = [fault for fault in late if isinstance(fault, LinkDelay) and _acts_always(fault, scenario)]
    starts = [fault.start_s for fault in late if fault.start_s < scenario.duration_s]
    most_us = (sum(_late_us(fault) for fault in late if _acts_at(fault, at_s)) for at_s in starts)
    constant_us = sum(map(_late_us, always))
    return constant_us // scenario.sample_us, max(most_us, default=0) // scenario.sample_us


def _acts_always(fault: LinkDelay | Jitter, scenario: Scenario) -> bool:
    return fault.start_s <= 0.0 and (fault.stop_s is None or fault.stop_s >= scenario.duration_s)


def _acts_at(fault: LinkDelay | Jitter, at_s: float) -> bool:
    return fault.start_s <= at_s and (fault.stop_s is None or at_s < fault.stop_s)


def _late_us(fault: LinkDelay | Jitter) -> int:
    return round(1e6 * (fault.delay_s if isinstance(fault, LinkDelay) else fault.most_s))


def hover_plant(
    vehicle: Vehicle, scenario: Scenario, *, with_attitude: bool = False, link_samples: int | None = None
) -> Lti:
    """Return torque command (3,) [N*m] to gyro (3,) [rad/s] at hover, sampled and delayed as in `scenario`.

    The link delays by `link_samples`, by default those of the whole flight. With `with_attitude` the outputs include
    roll and pitch (2,) [rad], as an accelerometer on the test stand measures them by gravity. Unmeasured attitudes are
    no states; rates, actuators and delayed commands are.
    """
    full = linear_plant(vehicle)
    angles = [0, 1] if with_attitude else []
    states, outputs = [*angles, *range(3, full.order)], [3, 4, 5, *angles]
    A, C = full.A[np.ix_(states, states)], full.C[np.ix_(outputs, states)]
    system = Lti(A=A, B=full.B[states, :3], C=C, D=full.D[outputs, :3])
    plant = discretize_zoh(system, scenario.dt)
    late = link_delay_samples(scenario)[0] if link_samples is None else link_samples
    for _ in range(scenario.delay_samples + late):
        plant = series(delay(3, scenario.dt), plant)
    return plant


def linear_law(law: Law, inputs: int = 3) -> Lti:
    """Return the law within its limits, linear at level attitude, from its first `inputs` inputs to the command."""
    rates = np.eye(3, law.order, 3)
    return Lti(A=law.A + law.G @ rates, B=law.B[:, :inputs], C=law.C, D=law.D[:, :inputs], dt=law.dt)


def reference_loop(law: Law, plant: Lti) -> Lti:
    """Return the closed loop from reference (3,) to attitude (3,) [rad] over the sampled `plant` (attitude, gyro)."""
    # inputs (reference, u), outputs (attitude; gyro, reference)
    zero = np.zeros((plant.order, 3))
    D = np.vstack([np.hstack([np.zeros((6, 3)), plant.D]), np.eye(3, 6)])
    P = Lti(A=plant.A, B=np.hstack([zero, plant.B]), C=np.vstack([plant.C, zero.T]), D=D, dt=plant.dt)
    return lft(P, linear_law(law, inputs=6))


def loop_law(law: Law) -> Lti:
    """Return the law within its limits, linear at hover, from the measurements that close its loop to the command.

    These are the gyro (3,), and roll and pitch (2,) [rad] by the specific force if the law reads the accelerometer.
    """
    K = linear_law(law, inputs=law.D.shape[1])
    measured = [k for k in range(K.n_inputs) if not 3 <= k < 6]  # all but the reference
    return Lti(A=K.A, B=K.B[:, measured], C=K.C, D=K.D[:, measured], dt=K.dt)


def is_stable_at_hover(
    law: Law, vehicle: Vehicle, scenario: Scenario, *, link_samples: int | None = None
) -> bool | None:
    """Return whether the linear loop is stable; `None` for a rates law, whose loop is the autopilot's own.

    The link delays by `link_samples`, by default those of the whole flight.
    """
    if law.output is not Output.TORQUE:
        return None
    plant = hover_plant(vehicle, scenario, with_attitude=law.uses_accelerometer, link_samples=link_samples)
    return lft(plant, loop_law(law)).is_stable()
