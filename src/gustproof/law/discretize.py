"""Discretisation of continuous controllers: the law form of `gustproof.law.form`."""

import math

import numpy as np

from gustproof.law.form import GRAVITY_AIDED_SIZE, GYRO_REFERENCE_SIZE, Law, Output, Provenance, RateLimit, Schedule
from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_continuous
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import RealBlock

TANGENTS = {"t": "phi", "v": "theta"}
"""Angle by the name of the tangent of its half, as in `gustproof.airframe.rotational`."""


def central_law(
    name: str,
    K: LinearSystem | Uncertain,
    *,
    scheduled: bool,
    dt: float,
    limits: Matrix,
    output: Output,
    provenance: Provenance,
    rate_limits: Matrix | None = None,
) -> Law:
    """Return the law of a central controller; its states estimate those of the plant.

    With `scheduled`, the estimate's kinematics `E' = omega` become `E' = T(E) omega`. At level attitude the law equals
    the linear one exactly.

    A `K` with the parameters t, v, p, q, r of `gustproof.airframe.rotational` keeps them as a schedule. It may be
    closed by constant parameters before or after sampling: the law is the same.

    `H` is 0. Measurements alone drive a central controller, so a stable one (all shipped ones are) cannot wind up. Its
    estimate expects a worst-case disturbance that only the full command opposes. Feeding back the saturated command
    was tried: it spoils the attitude estimate two to twenty times as much.

    Parameters
    ----------
    name
        Name of the law.
    K
        Continuous central controller of order n, as `hinfsyn` returns it; 3 inputs (gyro) or 6 (gyro, reference), and 2
        more for measured roll and pitch; 3 outputs. Its states begin with Euler angles and body rates. Or such a system
        of real parameters.
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
    rate_limits
        (3,) [rad/s] largest rate commanded from attitude; by default the law has no such limit.

    Raises
    ------
    ValueError
        If `K` is discrete, or a parameter is not one of a schedule.
    DesignError
        If `K` has a pole at 2/dt.

    Examples
    --------
    >>> import numpy as np
    >>> from control import ss
    >>> from gustproof import Output, Provenance, central_law
    >>> I, O = np.eye(3), np.zeros((3, 3))
    >>> K = ss(np.block([[O, I], [-4.0 * I, -4.0 * I]]), np.vstack([O, I]), np.hstack([-I, -I]), O)
    >>> law = central_law(
    ...     "mine", K, scheduled=False, dt=0.004, limits=np.array([1.0, 1.0, 0.5]), output=Output.TORQUE,
    ...     provenance=Provenance(design="by hand", vehicle="paper"),
    ... )
    >>> law.order
    6
    """
    parameters = _parameters(K) if isinstance(K, Uncertain) else []
    whole = as_continuous("K", K.M if isinstance(K, Uncertain) else K)
    K, k = whole.subsystem(slice(len(parameters), None), slice(len(parameters), None)), len(parameters)
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
        rate_limit=None if rate_limits is None else _rate_limit(K, dt, rate_limits),
        schedule=_schedule(tustin(whole, dt), parameters) if k else None,
    )


def _parameters(K: Uncertain) -> list[tuple[str, float]]:
    """Return parameter and limit for each channel of Delta, as a schedule has them."""
    found: list[tuple[str, float]] = []
    for block in K.blocks:
        if not (isinstance(block, RealBlock) and block.name in (*TANGENTS, "p", "q", "r")):
            raise ValueError(f"block '{block.name}': a schedule takes the real parameters t, v, p, q, r alone")
        if not (block.low == -block.high and block.nominal == 0.0):
            raise ValueError(f"block '{block.name}': is {block.low:g} to {block.high:g}, must be symmetric about 0")
        angle = TANGENTS.get(block.name)
        entry = (angle, 2.0 * math.atan(block.high)) if angle else (block.name, block.high)
        found += [entry] * block.repeats
    return found


def _schedule(sampled: Lti, parameters: list[tuple[str, float]]) -> Schedule:
    """Return the schedule of a sampled controller whose first channels are those of Delta."""
    k = len(parameters)
    return Schedule(
        parameters=tuple(name for name, _ in parameters),
        limits=np.array([limit for _, limit in parameters]),
        J=sampled.C[:k],
        K=_measurement_columns(sampled.D[:k, k:]),
        L=sampled.D[:k, :k],
        P=sampled.D[k:, :k],
        Q=sampled.B[:, :k],
    )


def _rate_limit(K: Lti, dt: float, limits: Matrix) -> RateLimit:
    """Return the limit of the rate that `K` commands from attitude: its gain of attitude over its gain of rate.

    The excess changes the attitude that is fed back, in the command and in what the controller expects from it. The
    leak is part of that: otherwise the estimate of a large attitude would leak away before it is flown back.
    """
    fed_back, gain, is_gravity_aided = K.A[:, :3].copy(), K.C[:, :3], K.n_inputs % 3 == 2
    if is_gravity_aided:  # measured roll and pitch correct the estimates, by their difference: no feedback
        fed_back[:, :2] += K.B[:, -2:]
    excess = tustin(Lti(A=K.A, B=fed_back, C=K.C, D=gain), dt)
    angle_p = np.diag(gain) / np.diag(K.C[:, 3:6] + K.D[:, :3])
    reference = np.eye(3, GRAVITY_AIDED_SIZE if is_gravity_aided else GYRO_REFERENCE_SIZE, 3)
    return RateLimit(
        S=0.0 - angle_p[:, None] * np.eye(3, K.order),  # no -0.0 in a file
        T=angle_p[:, None] * reference * (K.n_inputs >= GYRO_REFERENCE_SIZE),
        U=0.0 - excess.D / angle_p,
        V=0.0 - excess.B / angle_p,
        limits=limits,
    )


def _measurement_columns(matrix: Matrix) -> Matrix:
    """Return the columns for `y` from a controller's: gyro, then reference and measured roll and pitch if present."""
    has_tilt = matrix.shape[1] % 3 == 2
    rates_reference, tilt = np.split(matrix, [matrix.shape[1] - 2 * has_tilt], axis=1)
    first = np.pad(rates_reference, ((0, 0), (0, 6 - rates_reference.shape[1])))
    return np.hstack([first, tilt]) if has_tilt else first
