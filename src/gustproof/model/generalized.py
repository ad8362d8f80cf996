"""The attitude design problem as a labelled diagram."""

from dataclasses import dataclass

import numpy as np

from firmware_model.config.vehicle import Vehicle
from gustproof.lti.state_space import Lti, Matrix, gain
from gustproof.model.interconnection import Block, Interconnection, Signal, Sum
from gustproof.model.lpv import actuators, airframe, rate_loop


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weights:
    """Weights of the diagram, each (3, 3) unless stated."""

    W_d: Lti
    """[N*m] disturbance moment for a unit exogenous input."""
    W_n: Lti
    """[rad/s] gyro noise for a unit exogenous input."""
    W_e: Lti
    """[1/rad] on the attitude error."""
    W_u: Lti
    """[1/(N*m), or 1/(rad/s)] on the command."""
    W_r: Lti | None = None
    """[rad] attitude reference for a unit exogenous input; `None` for a regulator."""
    W_l: Lti | None = None
    """[rad] (2, 2) error of roll and pitch measured by the accelerometer; `None` for a gyro-only law."""
    W_m: Lti | None = None
    """[1/(N*m)] on the residual moment, disturbance plus torque; `None` does not weight it."""


def torque_problem(vehicle: Vehicle, weights: Weights, *, leak: float, rate_damping: float) -> Interconnection:
    """Return the design problem of a torque law: actuators, airframe, gyro, and the weights.

    - `w` = (disturbance, gyro noise, reference if `W_r`, levelling error if `W_l`).
    - `z` = (weighted attitude error, weighted command, weighted moment if `W_m`).
    - `y` = (gyro, reference if `W_r`, roll and pitch if `W_l`).
    - `u` = torque command [N*m] B.

    With a reference the leak pulls towards it. Holding an attitude then needs no rate in the model, as in the vehicle,
    which has no leak. With `W_l` roll and pitch are measured, and the leak is on yaw alone.
    """
    leaks = _leaks(leak, weights)
    body = airframe(vehicle, leak=leaks, rate_damping=rate_damping)
    blocks = [
        _body_block("airframe", "airframe", body, ("moment",), leaks, weights),
        Block(name="actuators", label="actuators", system=actuators(vehicle), inputs=("u",), outputs=("torque",)),
    ]
    extra = (
        Signal(name="torque", label=r"$\tau$", width=3, unit="N m"),
        Signal(name="moment", label=r"$\tau + d$", width=3, unit="N m"),
    )
    moment = Sum(output="moment", terms=((1, "torque"), (1, "disturbance")))
    return _problem(blocks, extra, (moment,), weights, "N m")


def rates_problem(vehicle: Vehicle, weights: Weights, *, leak: float, tau: float) -> Interconnection:
    """Return the design problem of a law that commands rates: the autopilot's rate loop replaces the actuators.

    Signals as in `torque_problem`, but `u` = rate command [rad/s] B, tracked with the lag `tau` [s].

    Raises
    ------
    ValueError
        If there is a `W_m`: the diagram has no signal for the autopilot's torque.
    """
    leaks = _leaks(leak, weights)
    body = rate_loop(vehicle, leak=leaks, tau=tau)
    block = _body_block("rate_loop", "autopilot's\nrate loop", body, ("u", "disturbance"), leaks, weights)
    return _problem([block], (), (), weights, "rad/s")


def _leaks(leak: float, weights: Weights) -> Matrix:
    """Return the leak [1/s] of each axis: a measured angle needs none."""
    return np.full(3, leak) if weights.W_l is None else np.array([0.0, 0.0, leak])


def _body_block(name: str, label: str, body: Lti, inputs: tuple[str, ...], leaks: Matrix, weights: Weights) -> Block:
    if weights.W_r is not None:
        pull = np.vstack([np.diag(leaks), np.zeros((3, 3))])
        body = Lti(A=body.A, B=np.hstack([body.B, pull]), C=body.C, D=np.hstack([body.D, np.zeros((6, 3))]))
        inputs = (*inputs, "reference")
    return Block(name=name, label=label, system=body, inputs=inputs, outputs=("attitude", "rates"))


def _problem(
    plant: list[Block], extra: tuple[Signal, ...], sums: tuple[Sum, ...], weights: Weights, unit: str
) -> Interconnection:
    tracking = weights.W_r is not None
    signals = [
        Signal(name="w_d", label="$w_d$", width=3),
        Signal(name="w_n", label="$w_n$", width=3),
        Signal(name="disturbance", label="$d$", width=3, unit="N m"),
        Signal(name="noise", label=r"$\nu$", width=3, unit="rad/s"),
        Signal(name="attitude", label=r"$(\phi, \theta, \psi)$", width=3, unit="rad"),
        Signal(name="rates", label="$(p, q, r)$", width=3, unit="rad/s"),
        Signal(name="gyro", label="$y_m$", width=3, unit="rad/s"),
        Signal(name="u", label="$u$", width=3, unit=unit),
        Signal(name="z_e", label="$z_e$", width=3),
        Signal(name="z_u", label="$z_u$", width=3),
        *extra,
    ]
    error = "error" if tracking else "attitude"
    blocks = [
        *plant,
        Block(name="W_d", label="$W_d$", system=weights.W_d, inputs=("w_d",), outputs=("disturbance",)),
        Block(name="W_n", label="$W_n$", system=weights.W_n, inputs=("w_n",), outputs=("noise",)),
        Block(name="W_e", label="$W_e$", system=weights.W_e, inputs=(error,), outputs=("z_e",)),
        Block(name="W_u", label="$W_u$", system=weights.W_u, inputs=("u",), outputs=("z_u",)),
    ]
    junctions = [*sums, Sum(output="gyro", terms=((1, "rates"), (1, "noise")))]
    if weights.W_r is not None:
        signals += [
            Signal(name="w_r", label="$w_r$", width=3),
            Signal(name="reference", label="$r$", width=3, unit="rad"),
            Signal(name="error", label="$e$", width=3, unit="rad"),
        ]
        blocks.append(Block(name="W_r", label="$W_r$", system=weights.W_r, inputs=("w_r",), outputs=("reference",)))
        junctions.append(Sum(output="error", terms=((1, "attitude"), (-1, "reference"))))
    w, z, y = ["w_d", "w_n", *["w_r"] * tracking], ["z_e", "z_u"], ["gyro", *["reference"] * tracking]
    if weights.W_l is not None:
        signals += [
            Signal(name="w_l", label="$w_l$", width=2),
            Signal(name="tilt", label=r"$(\phi, \theta)$", width=2, unit="rad"),
            Signal(name="levelling", label=r"$\nu_l$", width=2, unit="rad"),
            Signal(name="level", label="$y_l$", width=2, unit="rad"),
        ]
        blocks += [
            Block(name="gravity", label="gravity", system=gain(np.eye(2, 3)), inputs=("attitude",), outputs=("tilt",)),
            Block(name="W_l", label="$W_l$", system=weights.W_l, inputs=("w_l",), outputs=("levelling",)),
        ]
        junctions.append(Sum(output="level", terms=((1, "tilt"), (1, "levelling"))))
        w, y = [*w, "w_l"], [*y, "level"]
    if weights.W_m is not None:
        signals.append(Signal(name="z_m", label="$z_m$", width=3))
        blocks.append(Block(name="W_m", label="$W_m$", system=weights.W_m, inputs=("moment",), outputs=("z_m",)))
        z = [*z, "z_m"]
    return Interconnection(
        signals=tuple(signals),
        blocks=tuple(blocks),
        sums=tuple(junctions),
        w=tuple(w),
        u=("u",),
        z=tuple(z),
        y=tuple(y),
    )
