"""Proved bounds of what single precision adds to a flight: the law's certified box, and its roundings within it."""

import math
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np

from firmware_model.config.files import read_text
from firmware_model.config.vehicle import vehicle_path
from gustproof.checker.directed_rounding import float_down, float_up, list_down, print_down, print_up
from gustproof.checker.evidence_types import FlightEvidence
from gustproof.checker.flight_box import make_case, read_claim, spread_system
from gustproof.checker.kernel_norms import axis_norms
from gustproof.checker.single_precision import Form, bound_rounding
from gustproof.checker.system import Refusal, read_system
from gustproof.law.form import Law
from gustproof.law.write.c import resting_states
from gustproof.law.write.single import SingleLaw
from gustproof.prove.boundedness import certify_boundedness

_DIGITS = 2
"""Digits of a printed bound."""
_MOMENT = (0.65, 0.65, 0.3)
"""(3,) [N*m] B, bound of the disturbance moment, as `certify` has it by default."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundingBound:
    """Proved bounds of what single precision adds to a flight within a certified box."""

    own_deg: tuple[float, ...]
    """(3,) [deg] law's own phi, theta, psi, for ever."""
    command: tuple[float, ...]
    """(3,) [N*m or rad/s] B, command, for ever."""
    attitude_deg: float | None
    """[deg] angle of the true attitude after `horizon`; `None` for a law that is not on strapdown attitude."""
    horizon: float
    """[s] duration of the flight."""
    moment: tuple[float, ...]
    """(3,) [N*m] B, disturbance within which the flight stays in its box."""
    heading: float
    """[rad] bound of the magnitude of yaw and of its reference."""

    def to_dict(self) -> dict[str, Any]:
        """Return the bounds as JSON values."""
        return {
            "proven": True,
            "own_deg": list(self.own_deg),
            "command": list(self.command),
            "attitude_deg": self.attitude_deg,
            "horizon_s": self.horizon,
            "moment_N_m": list(self.moment),
            "heading_rad": self.heading,
            "statement": self.describe(),
        }

    def describe(self) -> str:
        """Return the bounds and what they assume, in a sentence or two."""
        command = ", ".join(print_up(value, _DIGITS) for value in self.command)
        changed = f"the law's own attitude by at most {print_up(max(self.own_deg), _DIGITS)} deg"
        if self.attitude_deg is not None:
            true = print_up(self.attitude_deg, _DIGITS)
            changed += f" and the true one by at most {true} deg in {print_down(self.horizon)} s"
        heading = print_down(math.degrees(self.heading), 3)
        return (
            f"Proved: rounding in single precision changes {changed}, and the commands by at most {command}, about "
            f"level, yaw within {heading} deg, under any moment within {list_down(self.moment)} N m, with the same "
            "errors of the gyro, on the law's own attitude."
        )


def certify_rounding(
    law: Law,
    vehicle: str | Path,
    *,
    horizon: float = 3600.0,
    moment: tuple[float, float, float] = _MOMENT,
    heading: float = math.pi,
) -> RoundingBound:
    """Return the proved bound of what `gustproof.law.write.single.SingleLaw` adds to a flight of the law.

    Parameters
    ----------
    law
        Law of gyros, each axis by itself.
    vehicle
        Name of a shipped vehicle or a vehicle file.
    horizon
        [s] of the flight, for the true attitude.
    moment
        (3,) [N*m] B, bound of the disturbance moment about each axis; the bound holds for the part that is certified.
    heading
        [rad] bound of the magnitude of yaw and of its reference.

    Raises
    ------
    ValueError
        If the law has another form, no box of it is proven, or its roundings are not small.

    Examples
    --------
    >>> from gustproof import certify_rounding, load_law
    >>> bound = certify_rounding(load_law("flagship"), "paper")
    >>> bound.attitude_deg < 0.02
    True
    """
    form = SingleLaw(law)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "law.json"
        law.save(path)
        certificate = certify_boundedness(path, vehicle, moment=moment, horizon=None)
        law_text = read_text(path)
    if not certificate.proven:
        raise ValueError(f"no box is proven for law '{law.name}': {certificate.statement}")
    claim = read_claim(cast(FlightEvidence, certificate.evidence))
    system = spread_system(read_system(law_text, read_text(vehicle_path(vehicle))), claim)
    norms = [axis_norms(system, axis, claim.samples) for axis in range(3)]
    resting = [Fraction(value) for value in np.abs(resting_states(law)[:, 2]).tolist()]
    references = [[Fraction(value) for value in row] for part in (law.B, law.D) for row in part[:, 3:6].tolist()]
    assumed = Form(frozenset(form.wide), Fraction(heading), resting)
    try:
        found = bound_rounding(system, norms, make_case(system, claim), claim.box, assumed, references)
    except Refusal as refusal:
        raise ValueError(str(refusal)) from None
    own, steps = sum(found.own, Fraction(0)), math.ceil(horizon / law.dt)
    return RoundingBound(
        own_deg=tuple(map(_up_deg, found.own)),
        command=tuple(float(print_up(value, _DIGITS)) for value in found.command),
        attitude_deg=None if found.drift is None else _up_deg(own + found.drift * steps),
        horizon=horizon,
        moment=tuple(float_down(claim.certified_fraction * value) for value in claim.moment),
        heading=heading,
    )


def _up_deg(angle: Fraction) -> float:
    """Return an angle [rad] in degrees, not rounded down."""
    return float(print_up(math.degrees(float_up(angle)) * (1.0 + 1e-12), _DIGITS))
