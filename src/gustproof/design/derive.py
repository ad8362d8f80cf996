"""Derive a flyable law from a design, with a report of its figures."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.types import AXES
from gustproof.airframe.hover import loop_law
from gustproof.airframe.step_response import StepResponse, step_response
from gustproof.design.designs import Design, Weight, design_problem, model_damping
from gustproof.errors import DesignError
from gustproof.law.discretize import central_law
from gustproof.law.form import Law, Output, Provenance
from gustproof.robust.hinf.checked_controller import CheckedController
from gustproof.robust.hinf.hinfsyn import HinfResult, hinfsyn
from gustproof.robust.lpv.lpvsyn import LftController
from gustproof.robust.lti.margins import LoopMargins, Margins, margins
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix, delay, discretize_zoh, lft, sensitivity, series
from gustproof.robust.uncertain.interconnection import Interconnection

Solver = Callable[[Design, Interconnection], CheckedController]
"""Function that returns the controller for a design's labelled diagram."""


class WeightedTransfer(NamedTuple):
    """Gain from one cause to one effect of a design, axis by axis, without the weights, and its bound by them."""

    cause: str
    """Exogenous input."""
    effect: str
    """Performance output."""
    units: tuple[str, str]
    """Units of the effect and of the cause."""
    gains: Matrix
    """(k, 3) [units] gains of roll, pitch and yaw, over frequency."""
    bounds: Matrix
    """(k, 3) [units] level divided by the gains of both weights."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignReport:
    """Results of a solved design."""

    design: Design
    """The design."""
    vehicle: str
    """Name of the vehicle."""
    problem: Interconnection
    """Labelled diagram of the problem."""
    result: CheckedController
    """Controller, levels and achieved norm."""
    continuous: Margins
    """Margins of the continuous controller in the design model."""
    sampled: Margins
    """Margins of the law at its sample time, the plant's input held and one sample late."""
    step: StepResponse | None
    """Response of the vehicle without leak to a step of the reference; `None` for a regulator."""

    @property
    def gamma_opt(self) -> float | None:
        """Least level of any controller, if the method tells it."""
        least: float | None = getattr(self.result, "gamma_opt", None)
        return least

    def poles(self) -> ComplexMatrix:
        """Return the controller's poles, (n,) [rad/s], slowest first."""
        poles = self.result.lti.poles()
        return poles[np.argsort(np.abs(poles), kind="stable")]

    def singular_values(self, omega: Matrix) -> dict[str, Matrix]:
        """Return singular values (k, j) at the frequencies `omega` (k,) [rad/s], keyed by the name of the transfer."""
        controller = self.result.lti
        G, K = _loop(self.problem, controller)
        L = series(G, -K)
        S = sensitivity(L)
        responses = {
            "w to z": lft(self.problem.plant(), controller).response(omega),
            "S, plant input": (response := S.response(omega)),
            "T, plant input": np.eye(S.n_outputs) - response,
            "L, plant input": L.response(omega),
        }
        return {
            name: np.asarray(np.linalg.svd(values, compute_uv=False), dtype=np.float64)
            for name, values in responses.items()
        }

    def weighted_transfers(self, omega: Matrix) -> tuple[WeightedTransfer, ...]:
        """Return the transfer from each cause to each effect at the frequencies `omega` (k,) [rad/s]."""
        design, problem = self.design, self.problem
        response = lft(problem.plant(), self.result.lti).response(omega)
        command = "rad/s" if design.rate_loop_lag is not None else "N m"
        inputs = [("w_d", "moment", "N m", design.W_d), ("w_n", "gyro noise", "rad/s", design.W_n)]
        if design.W_r is not None:
            inputs.append(("w_r", "reference", "rad", design.W_r))
        outputs = (("z_e", "attitude error", "rad", design.W_e), ("z_u", "command", command, design.W_u))
        found = []
        for w, cause, cause_unit, W_in in inputs:
            for z, effect, effect_unit, W_out in outputs:
                rows, columns = _component_slice(problem.z, z), _component_slice(problem.w, w)
                scale = _weight_gains(W_out.system(), omega) * _weight_gains(W_in.system(), omega)
                gains = np.abs(np.diagonal(response[:, rows, columns], 0, 1, 2)) / scale
                units = (effect_unit, cause_unit)
                found.append(WeightedTransfer(cause, effect, units, gains, self.result.gamma / scale))
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON values; numbers that are not finite become `None`."""
        figures = {
            "design": self.design.name,
            "description": self.design.description,
            "vehicle": self.vehicle,
            "law": self.design.law or self.design.name,
            "order": self.result.order,
            "gamma_opt": self.gamma_opt,
            "gamma": self.result.gamma,
            "norm": self.result.norm,
            "checks": list(self.result.checks),
            "norm_omega_rad_s": _nonfinite_to_none({"": self.result.omega})[""],
            "leak_per_s": self.design.leak,
            "scheduled": self.design.scheduled or isinstance(self.result, LftController),
            "dt_s": self.design.dt,
            "continuous": margins_to_dict(self.continuous),
            "sampled": margins_to_dict(self.sampled),
            "poles_rad_s": [[float(pole.real), float(pole.imag)] for pole in self.poles()],
        }
        if self.step is not None:
            figures["step"] = _nonfinite_to_none(asdict(self.step.step_info()))
        return figures


def derive(design: Design, vehicle: Vehicle | None = None, *, solve: Solver | None = None) -> tuple[Law, DesignReport]:
    """Return the law of a design, and its report; `vehicle` defaults to the one named in the design.

    `solve` returns the controller. It defaults to the central controller of `hinfsyn` at the design's level.

    Raises
    ------
    DesignError
        If the problem is ill posed, no controller exists at the design's level, or one sample of delay makes the loop
        of the law unstable.
    ConfigError
        If there is no such vehicle.

    Examples
    --------
    >>> from gustproof import derive, load_design
    >>> law, report = derive(load_design("D1"))
    >>> f"{law.name}: level {report.result.gamma:.2f}, {law.order} states"
    'hinf-d1: level 0.25, 9 states'
    """
    vehicle = load_vehicle(design.vehicle) if vehicle is None else vehicle
    problem = design_problem(design, vehicle)
    result = (solve or solve_central)(design, problem)
    law = make_law(design, vehicle, result)
    G, K = _loop(problem, result.lti)
    try:
        sampled = margins(discretize_zoh(G, design.dt), series(loop_law(law), delay(3, design.dt)))
    except ValueError as error:
        raise DesignError(f"design {design.name}, sampled every {design.dt} s and one sample late: {error}") from None
    report = DesignReport(
        design=design,
        vehicle=vehicle.name,
        problem=problem,
        result=result,
        continuous=margins(G, K),
        sampled=sampled,
        step=None if design.W_r is None else step_response(law, vehicle, tau=design.rate_loop_lag),
    )
    return law, report


def make_law(design: Design, vehicle: Vehicle, result: CheckedController) -> Law:
    """Return the law of a design from its controller."""
    rates, is_lft = design.rate_loop_lag is not None, isinstance(result, LftController)
    return central_law(
        design.law or design.name,
        result.scheduled if isinstance(result, LftController) else result.lti,
        scheduled=design.scheduled and not is_lft,
        dt=design.dt,
        limits=np.array([vehicle.stabilizer.rate_limit] * 3 if rates else vehicle.torque_limit),
        output=Output.RATES if rates else Output.TORQUE,
        provenance=_make_provenance(design, vehicle, result),
        rate_limits=None if rates or not (design.scheduled or is_lft) else np.full(3, vehicle.stabilizer.rate_limit),
    )


def solve_central(design: Design, problem: Interconnection) -> HinfResult:
    """Return the central controller of a design at its level, or at its back-off from the least."""
    return hinfsyn(problem.plant(), problem.n_meas, problem.n_con, gamma=design.gamma, backoff=design.backoff)


def _loop(problem: Interconnection, controller: Lti) -> tuple[Lti, Lti]:
    """Return plant, from the command to the sensors, and controller of the feedback loop."""
    fed_back = tuple(name for name in problem.y if name != "reference")
    inputs = [k for k in range(controller.n_inputs) if "reference" not in problem.y or not 3 <= k < 6]
    return problem.system(("u",), fed_back), controller.subsystem(slice(None), inputs)


def _make_provenance(design: Design, vehicle: Vehicle, result: CheckedController) -> Provenance:
    parameters = {"gamma": result.gamma, "norm": result.norm, "leak_per_s": design.leak}
    least: float | None = getattr(result, "gamma_opt", None)
    if least is not None:
        parameters["gamma_opt"] = least
    if design.inner is not None:
        natural, ratio = design.inner.without_delay()
        parameters |= _by_axis("inner_omega_rad_s", natural.tolist()) | _by_axis("inner_damping", ratio.tolist())
    elif design.rate_loop_lag is not None:
        parameters["rate_loop_lag_s"] = design.rate_loop_lag
    else:
        damping, name = model_damping(design, vehicle), "rate_damping_per_s"
        parameters |= {name: damping[0]} if len(set(damping)) == 1 else _by_axis(name, damping)
        parameters["actuator_lag_s"] = vehicle.actuator_lag
    for name in ("W_l", "W_m"):
        parameters |= _by_axis(name, getattr(design, name) or ())
    for name in ("W_d", "W_n", "W_e", "W_u", "W_r"):
        parameters |= _weight_parameters(name, getattr(design, name))
    return Provenance.of(vehicle, f"{design.name}: {design.description}", parameters)


def _weight_parameters(name: str, weight: Weight | None) -> dict[str, float]:
    if weight is None:
        return {}
    if weight.low == weight.high:
        return _by_axis(name, weight.high)
    ends = _by_axis(f"{name}_low", weight.low) | _by_axis(f"{name}_high", weight.high)
    return {**ends, f"{name}_corner_rad_s": weight.corner}


def _by_axis(name: str, values: Sequence[float]) -> dict[str, float]:
    return {f"{name}_{axis}": value for axis, value in zip(AXES, values, strict=False)}


def margins_to_dict(margins_: Margins) -> dict[str, Any]:
    """Return margins as JSON values, by the plant's side and axis; infinite numbers become `None`."""
    figures: dict[str, Any] = {}
    for place in ("input", "output"):
        loops: tuple[LoopMargins, ...] = getattr(margins_, place)
        figures[place] = {"disk_margin": getattr(margins_, f"{place}_disk")}
        # the gyro's are the first measurements
        for axis, loop in zip(AXES, loops[:3], strict=True):
            gains = {"gain_margin": loop.gain_margin, "gain_reduction_margin": loop.gain_reduction_margin}
            phase = {"crossover_rad_s": loop.crossover, "phase_margin_deg": math.degrees(loop.phase_margin)}
            figures[place][axis] = _nonfinite_to_none(
                {**phase, **gains, "delay_margin_s": loop.delay_margin, "Ms": loop.Ms}
            )
    return figures


def _nonfinite_to_none(figures: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in figures.items()}


def _component_slice(names: tuple[str, ...], name: str) -> slice:
    """Return the slice of a signal of three components in a vector of such signals."""
    start = 3 * names.index(name)
    return slice(start, start + 3)


def _weight_gains(weight: Lti, omega: Matrix) -> Matrix:
    """Return the gains (k, 3) of a diagonal weight."""
    return np.abs(np.diagonal(weight.response(omega), 0, 1, 2))
