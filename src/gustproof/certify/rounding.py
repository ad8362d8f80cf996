"""What single precision adds to a flight: a certified box of the law, and the bound of its roundings within it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from firmware_model.config.files import read_text
from firmware_model.config.vehicle import vehicle_path
from gustproof.certify.boundedness import certify_boundedness
from gustproof.certify.check.flight_box import make_case, read_claim, spread_system
from gustproof.certify.check.kernel_norms import axis_norms
from gustproof.certify.check.single_precision import Form, bound_rounding
from gustproof.certify.check.system import Refusal, read_system
from gustproof.law.form import Law
from gustproof.law.io.c import resting_states
from gustproof.law.io.single import SingleLaw

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

    def describe(self) -> str:
        """Return the bounds and what they assume, in a sentence or two."""
        moment = ", ".join(f"{value:.3g}" for value in self.moment)
        command = ", ".join(f"{_up(value):g}" for value in self.command)
        own = f"the law's own attitude by at most {_up(max(self.own_deg)):g} deg"
        true = "" if self.attitude_deg is None else (
            f" and the true one by at most {_up(self.attitude_deg):g} deg in {self.horizon:g} s"
        )  # fmt: skip
        return (
            f"Proved: rounding in single precision changes {own}{true}, and the commands by at most {command}, about "
            f"level, yaw within {math.degrees(self.heading):.0f} deg, under any moment within {moment} N m, with the "
            "same errors of the gyro, on the law's own attitude."
        )


def certify_rounding(
    law: Law,
    vehicle: str | Path,
    *,
    horizon: float = 3600.0,
    moment: tuple[float, float, float] = _MOMENT,
    heading: float = math.pi,
) -> RoundingBound:
    """Return the proved bound of what `gustproof.law.io.single.SingleLaw` adds to a flight of the law.

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
    claim = read_claim(certificate.evidence)
    system = spread_system(read_system(law_text, read_text(vehicle_path(vehicle))), claim)
    norms = [axis_norms(system, axis, claim.samples) for axis in range(3)]
    resting = np.abs(resting_states(law)[:, 2]).tolist()
    references = np.vstack([law.B[:, 3:6], law.D[:, 3:6]]).tolist()
    try:
        found = bound_rounding(
            system, norms, make_case(system, claim), claim.box,
            Form(frozenset(form.wide), Fraction(heading), [Fraction(value) for value in resting]), _rational(references),
        )  # fmt: skip
    except Refusal as refusal:
        raise ValueError(str(refusal)) from None
    true = None
    if found.drift is not None:
        true = _up_deg(sum(found.own, Fraction(0)) + found.drift * math.ceil(horizon / law.dt))
    return RoundingBound(
        own_deg=tuple(_up_deg(value) for value in found.own), command=tuple(_up(float(value)) for value in found.command),
        attitude_deg=true, horizon=horizon, moment=tuple(float(claim.part * value) for value in claim.moment),
        heading=heading,
    )  # fmt: skip


def _rational(rows: Sequence[Sequence[float]]) -> list[list[Fraction]]:
    return [[Fraction(value) for value in row] for row in rows]


def _up_deg(angle: Fraction) -> float:
    return _up(math.degrees(float(angle)))


def _up(value: float) -> float:
    """Return a number not below `value`, of two digits."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit * (1.0 - 1e-12)) * unit:.3g}") if value else 0.0
