"""The attitude design problem as a labelled diagram."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.lpv import actuators, airframe, inner_loops, rate_loop
from gustproof.robust.lti.state_space import Lti, Matrix, gain
from gustproof.robust.uncertain.interconnection import Block, Interconnection, Signal, Sum


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


def torque_problem(vehicle: Vehicle, weights: Weights, *, leak: float, rate_damping: ArrayLike) -> Interconnection:
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
    extra = tuple(_signals("N m", torque=r"$\tau$", moment=r"$\tau + d$"))
    moment = Sum(output="moment", terms=((1, "torque"), (1, "disturbance")))
    return _problem(blocks, extra, (moment,), weights, "N m")


def rates_problem(
    vehicle: Vehicle, weights: Weights, *, leak: float, tau: float, inner: tuple[Matrix, Matrix] | None = None
) -> Interconnection:
    """Return the design problem of a law that commands rates: the autopilot's rate loop replaces the actuators.

    Signals as in `torque_problem`, but `u` = rate command [rad/s] B, tracked with the lag `tau` [s], or by second-order
    loops with the natural frequencies (3,) [rad/s] and dampings (3,) [-] of `inner`.

    Raises
    ------
    ValueError
        If there is a `W_m`: the diagram has no signal for the autopilot's torque.
    """
    leaks = _leaks(leak, weights)
    if inner is None:
        body = rate_loop(vehicle, leak=leaks, tau=tau)
    else:
        body = inner_loops(vehicle, leak=leaks, omega=inner[0], damping=inner[1])
    block = _body_block("rate_loop", "autopilot's\nrate loop", body, ("u", "disturbance"), leaks, weights)
    return _problem([block], (), (), weights, "rad/s")


def _leaks(leak: float, weights: Weights) -> Matrix:
    """Return the leak [1/s] of each axis' attitude; roll and pitch need none where the law measures tilt."""
    return np.full(3, leak) if weights.W_l is None else np.array([0.0, 0.0, leak])


def _body_block(name: str, label: str, body: Lti, inputs: tuple[str, ...], leaks: Matrix, weights: Weights) -> Block:
    if weights.W_r is not None:
        pull = np.vstack([np.diag(leaks), np.zeros((body.order - 3, 3))])
        body = Lti(A=body.A, B=np.hstack([body.B, pull]), C=body.C, D=np.hstack([body.D, np.zeros((6, 3))]))
        inputs = (*inputs, "reference")
    return Block(name=name, label=label, system=body, inputs=inputs, outputs=("attitude", "rates"))


def _problem(
    plant: list[Block], extra: tuple[Signal, ...], sums: tuple[Sum, ...], weights: Weights, unit: str
) -> Interconnection:
    signals = [
        *_signals("", w_d="$w_d$", w_n="$w_n$"),
        *_signals("N m", disturbance="$d$"),
        *_signals("rad/s", noise=r"$\nu$"),
        *_signals("rad", attitude=r"$(\phi, \theta, \psi)$"),
        *_signals("rad/s", rates="$(p, q, r)$", gyro="$y_m$"),
        *_signals(unit, u="$u$"),
        *_signals("", z_e="$z_e$", z_u="$z_u$"),
        *extra,
    ]
    blocks = [
        *plant,
        _weight("W_d", weights.W_d, "w_d", "disturbance"),
        _weight("W_n", weights.W_n, "w_n", "noise"),
        _weight("W_e", weights.W_e, "attitude" if weights.W_r is None else "error", "z_e"),
        _weight("W_u", weights.W_u, "u", "z_u"),
    ]
    junctions = [*sums, Sum(output="gyro", terms=((1, "rates"), (1, "noise")))]
    w, z, y = ["w_d", "w_n"], ["z_e", "z_u"], ["gyro"]
    if weights.W_r is not None:
        signals += [*_signals("", w_r="$w_r$"), *_signals("rad", reference="$r$", error="$e$")]
        blocks.append(_weight("W_r", weights.W_r, "w_r", "reference"))
        junctions.append(Sum(output="error", terms=((1, "attitude"), (-1, "reference"))))
        w, y = [*w, "w_r"], [*y, "reference"]
    if weights.W_l is not None:
        signals += _signals("", 2, w_l="$w_l$")
        signals += _signals("rad", 2, tilt=r"$(\phi, \theta)$", levelling=r"$\nu_l$", level="$y_l$")
        tilt = Block(
            name="gravity", label="gravity", system=gain(np.eye(2, 3)), inputs=("attitude",), outputs=("tilt",)
        )
        blocks += [tilt, _weight("W_l", weights.W_l, "w_l", "levelling")]
        junctions.append(Sum(output="level", terms=((1, "tilt"), (1, "levelling"))))
        w, y = [*w, "w_l"], [*y, "level"]
    if weights.W_m is not None:
        signals += _signals("", z_m="$z_m$")
        blocks.append(_weight("W_m", weights.W_m, "moment", "z_m"))
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


def _signals(unit: str, width: int = 3, /, **labels: str) -> list[Signal]:
    """Return signals of one unit and width by name, each with its label."""
    return [Signal(name=name, label=label, width=width, unit=unit) for name, label in labels.items()]


def _weight(name: str, system: Lti, read: str, made: str) -> Block:
    return Block(name=name, label=f"${name}$", system=system, inputs=(read,), outputs=(made,))
