"""Certified gain of an attitude loop over an envelope of attitudes and rates that change at any speed."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from gustproof.airframe.rotational import Envelope, rotation, uncertain_airframe
from gustproof.checker.directed_rounding import print_down
from gustproof.checker.rational import RationalMatrix
from gustproof.law.form import Law
from gustproof.law.schedule import continuous_controller, sampled_controller
from gustproof.robust.gain.certificate import Certificate
from gustproof.robust.gain.exact_loop import loop_radius
from gustproof.robust.gain.lft_gain import certify_lft
from gustproof.robust.gain.parts import Delay, Part, Sector, Slope
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_continuous, as_lti
from gustproof.robust.uncertain.elements import ultidyn
from gustproof.robust.uncertain.interconnection import Interconnection
from gustproof.robust.uncertain.uncertain_system import (
    Uncertain,
    append,
    as_uncertain,
    fill_diagram,
    lft,
    system_from_matrix,
)
from gustproof.robust.uncertain.uncertainty import RealBlock, rows

_SAME_RANGE = 1e-9
"""[-] relative difference of ranges that counts as rounding."""
_SATURATION_POLES = (3.0,)
"""[rad/s] poles of the multipliers of a limit."""


def certify_gain(
    problem: Interconnection,
    controller: LinearSystem | Uncertain | Law,
    *,
    angle: float,
    rate: float,
    scheduled: bool = False,
    rate_bounded: bool = False,
    level: float | None = None,
    delay: Delay | None = None,
    saturation: float | None = None,
) -> Certificate:
    """Return a certificate of the L2 gain from w to z of a design problem closed by a continuous controller.

    The gain holds for |phi|, |theta| <= `angle` and |p|, |q|, |r| <= `rate` that change arbitrarily fast. The exact
    rotational dynamics of the diagram's airframe are an LFT of order 7, with Delta any function of time. With
    `rate_bounded`, phi and theta change no faster than the kinematics allow at such rates, and P depends on them. The
    proof still assumes nothing of the derivatives of p, q and r.

    Parameters
    ----------
    problem
        From `torque_problem`: its block "airframe" gives inertia, leak and damping.
    controller
        Continuous, `u = K y`; if `scheduled`, its first six states are its estimates of attitude and rates. Or an LFT
        in the parameters of `rotation`, as `lpvsyn` returns it: it knows them exactly, within its own ranges. Or a law
        with such a schedule: what it was sampled from, and the gain holds for whatever rounding did to the loop.
    angle
        [rad] of the envelope, below pi/2.
    rate
        [rad/s] of the envelope.
    scheduled
        True if the controller contains the same `A(rho)` as the airframe, with exact rho.
    rate_bounded
        True to use bounds on the speed of phi and theta; about ten times as slow.
    level
        [-] gain to certify; by default the least that can be proved.
    delay
        Delay of the command; `None` without one.
    saturation
        [-] largest command over the limit of the torque, above 1, or infinite; `None` without a limit.

    Raises
    ------
    ValueError
        If the envelope is invalid, the design commands rates, has a reference or an accelerometer, or the loop is
        unstable at hover. If the controller is discrete, or scheduled on smaller ranges. With infinite `saturation`
        also if plant or controller is not stable alone: the loop then has no gain, and `certify_boundedness` states
        what holds within a bounded moment.

    Examples
    --------
    >>> from gustproof import certify_gain, derive, design_problem, load_design, load_vehicle
    >>> design = load_design("D1")
    >>> problem = design_problem(design, load_vehicle("paper"))
    >>> controller = derive(design)[1].result.lti
    >>> certificate = certify_gain(problem, controller, angle=0.01, rate=0.05)
    >>> f"proven {certificate.proven}, gain {certificate.gain:.2f}"
    'proven True, gain 0.41'
    """
    parts = command_parts(delay, saturation)
    envelope = Envelope(angle=angle, rate=rate)
    loop = attitude_loop(problem, controller, envelope, scheduled=scheduled, delay=delay, saturation=saturation)
    leak, damping, _ = _airframe(problem)
    turning = attitude_speeds(angle, rate, leak=leak) if rate_bounded else None
    rho = (
        "any function of time within the envelope"
        if turning is None
        else (
            f"within the envelope, |phi'| <= {turning[0]:.6f} and |theta'| <= {turning[1]:.6f} rad/s, "
            "which the kinematics imply; p, q, r at any speed"
        )
    )
    return certify_lft(
        loop,
        assumes={
            "plant": "continuous, rotation exact, " + _describe_command(saturation),
            "leak_per_s": leak,
            "rate_damping_per_s": damping,
            **_describe_delay(delay),
            "angle_rad": angle,
            "rate_rad_s": rate,
            "rho": f"{rho}; exact in the controller" if scheduled or isinstance(controller, Uncertain | Law) else rho,
            "horizon_s": None,
            "noise": "part of w, square integrable",
        },
        level=level,
        speeds=envelope_speeds(angle, rate, leak=leak) if rate_bounded else None,
        parts=parts,
        radius=law_rounding(problem, controller, envelope, loop, delay=delay, saturation=saturation),
        signals="from disturbance and noise to error and command, all weighted,",
        scope=f"for all |phi|, |theta| <= {print_down(angle)} rad and |p|, |q|, |r| <= {print_down(rate)} rad/s",
    )


def command_parts(delay: Delay | None, saturation: float | None) -> dict[str, Part]:
    """Return the parts of the command's path by name, in the order in which the command meets them.

    What a limit takes off a command within `saturation` times the limit is a share of it, at most 1 - 1 / `saturation`.
    Of any command it has slopes in [0, 1].

    Raises
    ------
    ValueError
        If `saturation` is not above 1.
    """
    parts: dict[str, Part] = {} if delay is None else {"delay": delay}
    if saturation is None:
        return parts
    if not saturation > 1.0:
        raise ValueError(f"saturation is {saturation}, must be above 1: smaller commands meet no limit")
    return parts | {"saturation": Slope(poles=_SATURATION_POLES) if math.isinf(saturation) else Sector()}


def _describe_command(saturation: float | None) -> str:
    if saturation is None:
        return "actuators without limits"
    size = "of any size" if math.isinf(saturation) else f"of at most {print_down(saturation)} times the limit"
    return f"torque limited, commands {size}"


def _describe_delay(delay: Delay | None) -> dict[str, Any]:
    if delay is None:
        return {"delay_samples": 0}
    return {"delay_s": f"{'varies at will' if delay.varying else 'constant'}, in [0, {print_down(delay.largest)}]"}


def attitude_speeds(angle: float, rate: float, *, leak: float) -> tuple[float, float]:
    """Return bounds of |phi'| and |theta'| [rad/s] inside an envelope, from the kinematics and their leak [1/s].

    phi' = p + tan(theta) (sin(phi) q + cos(phi) r) - leak phi, theta' = cos(phi) q - sin(phi) r - leak theta.
    """
    across = rate * (1.0 + math.sin(angle))
    bounds = rate + math.tan(angle) * across + leak * angle, across + leak * angle
    of_phi, of_theta = (math.ceil(1e6 * bound + 1e-3) / 1e6 for bound in bounds)  # up: the printed value is used
    return of_phi, of_theta


def envelope_speeds(angle: float, rate: float, *, leak: float) -> dict[str, float]:
    """Return bounds [1/s] of the speeds of the normalised t and v inside an envelope."""
    edge = math.tan(angle / 2.0)  # t = tan(phi / 2) over its largest value, and v likewise
    turning = attitude_speeds(angle, rate, leak=leak)
    t, v = ((1.0 + 1e-9) * turn * (1.0 + edge**2) / (2.0 * edge) for turn in turning)
    return {"t": t, "v": v}


def attitude_loop(
    problem: Interconnection,
    controller: LinearSystem | Uncertain | Law,
    envelope: Envelope,
    *,
    scheduled: bool,
    delay: Delay | None = None,
    saturation: float | None = None,
) -> Uncertain:
    """Return the loop of a design problem and a controller, from w to z, with exact rotation over the envelope.

    The command passes the `command_parts`: what a delay changes is added to it, what a limit cuts off is taken away.
    """
    P = _driven_plant(problem, envelope, delay, saturation)
    if isinstance(controller, Uncertain | Law):
        turned = continuous_controller(controller) if isinstance(controller, Law) else controller
        return lft(P, _within_envelope(turned, P)[0], turned.n_inputs, turned.n_outputs)
    K = as_continuous("the controller", controller)
    if not scheduled:
        return lft(P, K)
    n, dynamics = K.order, rotation(_airframe(problem)[2], envelope)
    excess = (dynamics + -dynamics.nominal_system().D) @ np.eye(9, 6)  # what A(rho) adds to hover's
    system = np.block([[K.A, K.B], [K.C, K.D]]) + np.eye(n + K.n_outputs, 6) @ excess @ np.eye(6, n + K.n_inputs)
    return lft(P, system_from_matrix(system, n), K.n_inputs, K.n_outputs)


def law_rounding(
    problem: Interconnection,
    controller: LinearSystem | Uncertain | Law,
    envelope: Envelope,
    loop: Uncertain,
    *,
    delay: Delay | None = None,
    saturation: float | None = None,
) -> dict[str, RationalMatrix] | None:
    """Return how far rounding moved the numbers of the `attitude_loop` of a law; `None` if the controller is none."""
    if not isinstance(controller, Law):
        return None
    P = _driven_plant(problem, envelope, delay, saturation)
    turned, shares = _within_envelope(continuous_controller(controller), P)
    return loop_radius(P, turned, sampled_controller(controller)[0], shares, loop)


def _driven_plant(
    problem: Interconnection, envelope: Envelope, delay: Delay | None, saturation: float | None
) -> Uncertain:
    """Return the `attitude_plant` behind the parts of the command's path."""
    P = attitude_plant(problem, envelope)
    if delay is None and saturation is None:
        return P
    return P @ append(np.eye(P.n_inputs - problem.n_con), _command_path(problem.n_con, delay, saturation))


def _within_envelope(K: Uncertain, P: Uncertain) -> tuple[Uncertain, list[float]]:
    """Return a scheduled controller with its parameters normalised to the plant's ranges, about 0 as its own.

    The share of the controller's own range follows for each of its channels.

    Raises
    ------
    ValueError
        If a parameter is none of the plant's, or has a smaller range: there the controller holds it.
    """
    known = {block.name: block for block in P.blocks if isinstance(block, RealBlock)}
    blocks, shares = [], [1.0] * K.n_w
    for block, at in zip(K.blocks, rows(K.blocks), strict=True):
        plant = known.get(block.name)
        if plant is None or not isinstance(block, RealBlock):
            raise ValueError(f"the controller's block '{block.name}' is no parameter of the plant")
        share = plant.high / block.high
        if share > 1.0 + _SAME_RANGE:
            ends = f"up to {block.high:.6g}, the envelope is {plant.high:.6g}"
            raise ValueError(f"the controller is scheduled on '{block.name}' {ends}")
        blocks.append(replace(plant, repeats=block.repeats))
        shares[at] = [share] * block.repeats
    M, scale = K.M, np.append(shares, np.ones(K.n_inputs))
    scaled = Lti(A=M.A, B=M.B * scale, C=M.C, D=M.D * scale, dt=M.dt)
    return Uncertain(M=scaled, blocks=tuple(blocks)), shares


def attitude_plant(problem: Interconnection, envelope: Envelope) -> Uncertain:
    """Return the plant of a design problem, from (w, u) to (z, y), with exact rotation over the envelope."""
    leak, damping, inertia_B = _airframe(problem)
    dynamics = rotation(inertia_B, envelope)
    return fill_diagram(problem, {"airframe": uncertain_airframe(dynamics, leak=leak, rate_damping=damping)})


def _command_path(n: int, delay: Delay | None, saturation: float | None) -> Uncertain:
    """Return the path of `n` commands, with a full block for each of the `command_parts`."""
    path = as_uncertain(np.eye(n))
    if delay is not None:
        path = np.eye(n) + ultidyn("delay", n, n)
    if saturation is not None:
        path = (np.eye(n) - (1.0 - 1.0 / saturation) * np.eye(n) @ ultidyn("saturation", n, n)) @ path
    return path


def _airframe(problem: Interconnection) -> tuple[float, list[float], list[float]]:
    """Return leak [1/s], damping [1/s] and inertia [kg*m^2] by axis, of the diagram's airframe of states (E, omega)."""
    bodies = [as_lti(block.system) for block in problem.blocks if block.name == "airframe"]
    if not bodies:
        raise ValueError("certify supports torque designs only; this one has no airframe, as those that command rates")
    if "reference" in problem.y:
        raise ValueError("certify supports designs that hold level only: this one has a reference, W_r")
    A: Matrix = bodies[0].A
    if not A[0, 0] == A[1, 1] == A[2, 2]:
        raise ValueError("certify supports gyro-only designs: the leak differs between axes, as with an accelerometer")
    damping = [float(-A[k, k]) for k in range(3, 6)]
    return float(-A[0, 0]), damping, [float(1.0 / bodies[0].B[3 + k, k]) for k in range(3)]
