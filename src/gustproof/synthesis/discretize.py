"""From a continuous controller to a flying law: Tustin's rule, and the form of `gustproof.law`."""

import numpy as np

from gustproof.errors import DesignError
from gustproof.law import Law, Output, Provenance
from gustproof.numerics.lti import LinearSystem, Lti, Matrix, copied


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
        Central controller of order n, as `hinfsyn` returns it; 3 inputs (gyro) or 6 (gyro, reference), 3 outputs. Its
        states begin with Euler angles and body rates.
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
    """
    K = copied(K)
    n, measured = K.order, K.n_inputs
    # the attitude rows get an input of their own, whose sampled input matrix is G
    entries = np.hstack([K.B, np.eye(n, 3)])
    sampled = tustin(Lti(A=K.A, B=entries, C=K.C, D=np.hstack([K.D, np.zeros((3, 3))])), dt)
    B, G = np.split(sampled.B, [measured], axis=1)
    G = G if scheduled else np.zeros((n, 3))
    rates = np.eye(3, n, 3)
    padding = 6 - measured
    return Law(
        name=name,
        A=sampled.A - G @ rates,
        B=np.pad(B, ((0, 0), (0, padding))),
        C=sampled.C,
        D=np.pad(sampled.D[:, :measured], ((0, 0), (0, padding))),
        G=G,
        H=np.zeros((n, 3)),
        dt=dt,
        limits=limits,
        output=output,
        provenance=provenance,
    )


def linear_law(law: Law, inputs: int = 3) -> Lti:
    """Return the law linearised at level attitude within its limits, from its first `inputs` inputs to the command."""
    rates = np.eye(3, law.order, 3)
    return Lti(A=law.A + law.G @ rates, B=law.B[:, :inputs], C=law.C, D=law.D[:, :inputs], dt=law.dt)
