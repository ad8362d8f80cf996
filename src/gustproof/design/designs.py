"""Design files with the weights of an H-infinity problem, and the shipped designs by name."""

from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from firmware_model.config.fields import NOT_TRUTH, NonNegative, Positive, PositiveVector, strict_dataclass
from firmware_model.config.files import Name, list_shipped, read_toml
from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.generalized import Weights, rates_problem, torque_problem
from gustproof.design.inner_loops import InnerLoops
from gustproof.law.form import SAMPLE_TIMES
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.lti.weights import constant_weight, first_order_weight
from gustproof.robust.uncertain.interconnection import Interconnection

DESIGNS = Path(__file__).parent / "data"


@strict_dataclass
class Weight:
    """A weight on each axis with different gains at low and high frequency; in a file, a plain list is constant."""

    low: PositiveVector
    """[1/unit of the weighted signal] gain at low frequency, roll, pitch, yaw."""
    high: PositiveVector
    """[1/unit of the weighted signal] gain at high frequency."""
    corner: Positive
    """[rad/s] pole between the two."""

    def system(self) -> Lti:
        """Return the weight as a system; a constant weight has no states."""
        if self.low == self.high:
            return constant_weight(self.low)
        return first_order_weight(self.low, self.corner, self.high)


def _from_list(value: Any) -> Any:
    return {"low": value, "high": value, "corner": 1.0} if isinstance(value, list | tuple) else value


WeightField = Annotated[Weight, BeforeValidator(_from_list)]


@strict_dataclass
class Design:
    """Specification of a controller: model, weights, level.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import derive, load_design
    >>> calmer = replace(load_design("D1"), name="calmer", law="calmer", gamma=0.3)
    >>> derive(calmer)[0].name
    'calmer'
    """

    name: Name
    """Short name; defaults to the file's."""
    description: str
    """Description in one line."""
    leak: Positive
    """[1/s] the model's stability augmentation on the Euler kinematics; with `W_l` of yaw alone. No level is below
    W_e W_n / leak."""
    W_d: WeightField
    """[N*m] disturbance moment."""
    W_n: WeightField
    """[rad/s] gyro noise."""
    W_e: WeightField
    """[1/rad] on the attitude error."""
    W_u: WeightField
    """[1/(N*m), or 1/(rad/s)] on the command."""
    W_r: WeightField | None = None
    """[rad] attitude reference; without it the law regulates to level."""
    W_l: tuple[Positive, Positive] | None = None
    """[rad] error of roll and pitch measured by the accelerometer; without it the law is gyro-only."""
    W_m: tuple[NonNegative, NonNegative, NonNegative] | None = None
    """[1/(N*m)] on the residual moment, disturbance plus torque; bounds the sensitivity of the loop."""
    rate_damping: NonNegative | None = None
    """[1/s] the model's damping of rates; defaults to the vehicle's."""
    rate_loop_lag: Positive | None = None
    """[s] lag of the autopilot's rate loop; if given, the law commands rates instead of torque."""
    inner: InnerLoops | None = None
    """The autopilot's rate loops, in place of the lag alone; only beside `rate_loop_lag`, and without `W_r`."""
    gamma: Positive | None = None
    """[-] level to design for; defaults to `backoff` times the least."""
    backoff: Annotated[float, Field(gt=1.0, allow_inf_nan=False), NOT_TRUTH] = 1.05
    """[-] level as a multiple of the least."""
    scheduled: bool = False
    """True if the law uses the exact kinematics at its own attitude estimate, and limits the rate commanded from it to
    that of the vehicle's own loops."""
    dt: Annotated[float, Field(ge=SAMPLE_TIMES[0], le=SAMPLE_TIMES[1]), NOT_TRUTH] = 0.004
    """[s] sample time of the law, of 10 to 2000 Hz."""
    vehicle: str = "paper"
    """Vehicle to design for: a shipped name or a file."""
    law: Name | Literal[""] = field(default="")
    """Name of the law; defaults to the design's."""

    @model_validator(mode="after")
    def _check_moment_weight(self) -> Self:
        if self.W_m is not None and self.rate_loop_lag is not None:
            raise ValueError("W_m weights the moment of a law that commands torque, not rates")
        if self.inner is not None and (self.rate_loop_lag is None or self.W_r is not None):
            raise ValueError("inner is for a law with rate_loop_lag and without W_r")
        return self


def load_design(name_or_path: str | Path) -> Design:
    """Read a design file, or a shipped one by its name.

    Raises
    ------
    ConfigError
        If there is no such file, or a key or value is not allowed.

    Examples
    --------
    >>> from gustproof import load_design
    >>> load_design("D1").law
    'hinf-d1'
    """
    return read_toml(Design, name_or_path, DESIGNS)


def list_designs() -> tuple[str, ...]:
    """Return the names of the shipped designs.

    Examples
    --------
    >>> from gustproof import list_designs
    >>> "D1" in list_designs()
    True
    """
    return list_shipped(DESIGNS)


def design_problem(design: Design, vehicle: Vehicle) -> Interconnection:
    """Return the labelled diagram of `design` for `vehicle`, for synthesis and for the figure.

    Examples
    --------
    >>> from gustproof import design_problem, load_design, load_vehicle
    >>> problem = design_problem(load_design("D1"), load_vehicle("paper"))
    >>> (problem.plant().order, problem.n_meas, problem.n_con)
    (9, 3, 3)
    """
    weights = Weights(
        W_d=design.W_d.system(),
        W_n=design.W_n.system(),
        W_e=design.W_e.system(),
        W_u=design.W_u.system(),
        W_r=None if design.W_r is None else design.W_r.system(),
        W_l=None if design.W_l is None else constant_weight(design.W_l),
        W_m=None if design.W_m is None else constant_weight(design.W_m),
    )
    if design.rate_loop_lag is not None:
        inner = None if design.inner is None else design.inner.without_delay()
        return rates_problem(vehicle, weights, leak=design.leak, tau=design.rate_loop_lag, inner=inner)
    return torque_problem(vehicle, weights, leak=design.leak, rate_damping=model_damping(design, vehicle))


def model_damping(design: Design, vehicle: Vehicle) -> tuple[float, float, float]:
    """Return the damping of rates [1/s] B in the model: the design's about every axis, or the vehicle's."""
    return vehicle.rate_damping_B if design.rate_damping is None else (design.rate_damping,) * 3
