"""Discretisation of continuous controllers: Tustin's rule, and the law form of `gustproof.law.form`."""

import numpy as np

from firmware_model.config.vehicle import GRAVITY
from gustproof.errors import DesignError
from gustproof.law.form import Law, Output, Provenance
from gustproof.law.hover import FORCE_PER_TILT
from gustproof.lti.state_space import LinearSystem, Lti, Matrix, as_continuous


def tustin(K: Lti, dt: float) -> Lti:
    """Return the controller at the sample time `dt` [s] by the trapezoidal rule.

    The state is `x - dt/2 x'`: equal to that of `K` at rest, half a sample older in motion. So states keep their
    meaning, and an input matrix becomes `dt (I - A dt/2)^-1 B`.

    Raises
    ------
    DesignError
        If `K` has a pole at 2/dt, where the rule is singular.
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
    """Return the law of a central controller; its states estimate those of the plant.

    With `scheduled`, the estimate's kinematics `E' = omega` become `E' = T(E) omega`. At level attitude the law equals
    the linear one exactly.

    `H` is 0. Measurements alone drive a central controller, so a stable one (all shipped ones are) cannot wind up. Its
    estimate expects a worst-case disturbance that only the full command opposes. Feeding back the saturated command
    was tried: it spoils the attitude estimate two to twenty times as much.

    Parameters
    ----------
    name
        Name of the law.
    K
        Continuous central controller of order n, as `hinfsyn` returns it; 3 inputs (gyro) or 6 (gyro, reference), and 2
        more for measured roll and pitch; 3 outputs. Its states begin with Euler angles and body rates.
    scheduled
        True for exact kinematics of the estimate.
    dt
        [s] sample time.
    limits
        (3,) [N*m or rad/s] B, largest command.
    output
        Commanded quantity.
    provenance
        Origin of the law.

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
    # an input of its own for the attitude rows; its sampled input matrix is G
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
    """Return the columns for `y` from a controller's: gyro, then reference and measured roll and pitch if present."""
    has_tilt = matrix.shape[1] % 3 == 2
    rates_reference, tilt = np.split(matrix, [matrix.shape[1] - 2 * has_tilt], axis=1)
    first = np.pad(rates_reference, ((0, 0), (0, 6 - rates_reference.shape[1])))
    # tilt from the specific force: roll is -f_y / g, pitch f_x / g
    return np.hstack([first, tilt @ FORCE_PER_TILT.T / GRAVITY**2]) if has_tilt else first
