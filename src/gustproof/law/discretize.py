"""From a continuous controller to a flying law: Tustin's rule, and the form of `gustproof.law.form`."""

import numpy as np

from firmware_model.config.vehicle import GRAVITY
from gustproof.errors import DesignError
from gustproof.law.form import Law, Output, Provenance
from gustproof.law.hover import FORCE_PER_TILT
from gustproof.lti.state_space import LinearSystem, Lti, Matrix, as_continuous


def tustin(K: Lti, dt: float) -> Lti:
    """Return the controller at the sample time `dt` [s] by the trapezoidal rule.

    The state is `x - dt/2 x'`: equal to that of `K` at rest and half a sample older in motion, so states keep their
    meaning and an input matrix becomes `dt (I - A dt/2)^-1 B`.

    Raises
    ------
    DesignError
        If `K` has a pole at 2/dt, where the rule has none.
    """
    n = K.order
    implicit = np.eye(n) - 0.5 * dt * K.A
    if np.linalg.cond(implicit) > 1e12:
        raise DesignError(f"the controller has a pole at 2/dt = {2.0 / dt:.4g} rad/s: choose another sample time")
    inverse: Matrix = np.asarray(np.linalg.inv(implicit), dtype=np.float64)
    return Lti(
        A=inverse @ (np.eye(n) + 0.5 * dt * K.A),
        B=dt * inverse @ K.B,
        C=K.C @ inverse,
        D=K.D + 0.5 * dt * K.C @ inverse @ K.B,
        dt=dt,
    )


def central_law(
    name: str,
    K: LinearSystem,
    *,
    scheduled: bool,
    dt: float,
    limits: Matrix,
    output: Output,
    provenance: Provenance,
) -> Law:
    """Return the law of a central controller, whose states are estimates of the plant's.

    With `scheduled`, the estimate's kinematics `E' = omega` become `E' = T(E) omega`; at level attitude the law is the
    linear one exactly.

    `H` is 0. A central controller is driven by measurements alone, so if it is stable (all shipped ones are) it cannot
    wind up; and its estimate expects a worst-case disturbance that only the full command opposes, so to tell it what
    the limit left was tried and spoils the attitude estimate two to twenty times as much.

    Parameters
    ----------
    name
        Name of the law.
    K
        Continuous central controller of order n, as `hinfsyn` returns it; 3 inputs (gyro) or 6 (gyro, reference), and 2
        more if it is told roll and pitch; 3 outputs. Its states begin with Euler angles and body rates.
    scheduled
        Whether the kinematics of the estimate are exact.
    dt
        [s] sample time.
    limits
        (3,) [N*m or rad/s] B, largest command.
    output
        What is commanded.
    provenance
        Where it comes from.

    Raises
    ------
    ValueError
        If `K` is discrete.
    DesignError
        If `K` has a pole at 2/dt.

    Examples
    --------
    >>> import numpy as np
    >>> from gustproof import Lti, Output, Provenance, central_law
    >>> I, O = np.eye(3), np.zeros((3, 3))
    >>> K = Lti(A=np.block([[O, I], [-4.0 * I, -4.0 * I]]), B=np.vstack([O, I]), C=np.hstack([-I, -I]), D=O)
    >>> law = central_law(
    ...     "mine", K, scheduled=False, dt=0.004, limits=np.array([1.0, 1.0, 0.5]), output=Output.TORQUE,
    ...     provenance=Provenance(design="by hand", vehicle="paper"),
    ... )
    >>> law.order
    6
    """
    K = as_continuous("K", K)
    n, measured = K.order, K.n_inputs
    # the attitude rows get an input of their own, whose sampled input matrix is G
    entries = np.hstack([K.B, np.eye(n, 3)])
    sampled = tustin(Lti(A=K.A, B=entries, C=K.C, D=np.hstack([K.D, np.zeros((3, 3))])), dt)
    B, G = np.split(sampled.B, [measured], axis=1)
    G = G if scheduled else np.zeros((n, 3))
    rates = np.eye(3, n, 3)
    return Law(
        name=name,
        A=sampled.A - G @ rates,
        B=_measurement_columns(B),
        C=sampled.C,
        D=_measurement_columns(sampled.D[:, :measured]),
        G=G,
        H=np.zeros((n, 3)),
        dt=dt,
        limits=limits,
        output=output,
        provenance=provenance,
    )


def _measurement_columns(matrix: Matrix) -> Matrix:
    """Return the columns for `y` of a controller's for (gyro, reference if it has one, roll and pitch if told)."""
    levelled = matrix.shape[1] % 3 == 2
    told = np.split(matrix, [matrix.shape[1] - 2 * levelled], axis=1)
    first = np.pad(told[0], ((0, 0), (0, 6 - told[0].shape[1])))
    # as the specific force tells them: roll is -f_y / g, pitch f_x / g
    return np.hstack([first, told[1] @ FORCE_PER_TILT.T / GRAVITY**2]) if levelled else first
