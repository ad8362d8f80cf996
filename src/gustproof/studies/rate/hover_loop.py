"""Linear loop of a flying law at hover, sampled and delayed: poles, loop transfer, sensitivities, margins."""

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.law.form import Law, Output
from gustproof.robust.lti.margins import Margins, margins
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix, sensitivity, series

_POINTS = 400


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HoverLoop:
    """Linear figures of a law on a vehicle at hover, at the sample time and delay of a scenario."""

    margins: Margins | None
    """Margins, sampled and delayed; `None` for a rate law or an unstable loop."""
    law_poles: ComplexMatrix
    """(n,) [rad/s] poles of the law at level attitude, `log(z) / dt`."""
    loop_poles: ComplexMatrix
    """(m,) [rad/s] poles of the loop, `log(z) / dt`; empty for a rate law."""
    omega: Matrix
    """(k,) [rad/s] frequencies below half the sample rate, where a held plant has zero gain and no phase."""
    loop: ComplexMatrix
    """(k, 3) loop transfer of each axis at the plant's input, negative feedback; empty for a rate law."""
    sensitivities: dict[str, Matrix]
    """(k,) largest singular values of S and T at the plant's input; empty for a rate law."""


def hover_loop(law: Law, vehicle: Vehicle, scenario: Scenario) -> HoverLoop:
    """Return the loop of `law`; for a rate law only its poles, as it drives the autopilot's own loop."""
    controller = loop_law(law)
    omega = _grid(law)
    if law.output is not Output.TORQUE:
        return HoverLoop(
            margins=None,
            law_poles=_continuous_poles(controller),
            loop_poles=np.empty(0, dtype=np.complex128),
            omega=omega,
            loop=np.empty((0, 3), dtype=np.complex128),
            sensitivities={},
        )
    plant, loop = _open_loop(law, vehicle, scenario)
    S = sensitivity(loop)
    response = S.response(omega)
    both = {"S": response, "T": np.eye(3) - response}
    return HoverLoop(
        margins=margins(plant, controller) if S.is_stable() else None,
        law_poles=_continuous_poles(controller),
        loop_poles=_continuous_poles(S),
        omega=omega,
        loop=_axis_responses(loop, omega),
        sensitivities={name: np.linalg.norm(each, ord=2, axis=(1, 2)) for name, each in both.items()},
    )


def loop_response(law: Law, vehicle: Vehicle, scenario: Scenario) -> tuple[Matrix, ComplexMatrix]:
    """Return `omega` and `loop` of the `HoverLoop` of a torque law, without what takes long."""
    return _grid(law), _axis_responses(_open_loop(law, vehicle, scenario)[1], _grid(law))


def _grid(law: Law) -> Matrix:
    return np.geomspace(1e-2, math.pi / law.dt, _POINTS)[:-1]


def _open_loop(law: Law, vehicle: Vehicle, scenario: Scenario) -> tuple[Lti, Lti]:
    """Return the plant, and the loop broken at its input."""
    plant = hover_plant(vehicle, scenario, with_attitude=law.uses_accelerometer)
    return plant, -series(plant, loop_law(law))


def _axis_responses(loop: Lti, omega: Matrix) -> ComplexMatrix:
    return np.diagonal(loop.response(omega), 0, 1, 2)


def _continuous_poles(system: Lti) -> ComplexMatrix:
    """Return the poles of the equivalent continuous system, without poles at 0, which are pure delays."""
    poles = system.poles()
    return np.asarray(np.log(poles[np.abs(poles) > 1e-9]) / system.dt, dtype=np.complex128)
