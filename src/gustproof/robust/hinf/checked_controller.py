"""A controller that its closed loop vouches for: the result of every synthesis."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.lti.state_space import Lti, all_or_none, signal_names
from gustproof.robust.shown import Shown

if TYPE_CHECKING:
    import control

ROUNDING_ERRORS = (np.linalg.LinAlgError, OverflowError)
"""Errors by which arithmetic gives up."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CheckedController(Shown):
    """A controller with its level, and the norm of the loop that it closes, computed from that loop alone."""

    lti: Lti
    """The controller in this library's own form, read-only arrays; `K` is for users."""
    gamma: float
    """[-] level of the design, in the method's own measure."""
    norm: float
    """[-] norm of the closed loop that was checked; at most `gamma`."""
    omega: float
    """[rad/s] frequency of that norm."""
    checks: tuple[str, ...] = ()
    """Checks of the closed loop that were passed, a sentence each."""
    measured: tuple[str, ...] = ()
    """Names of the inputs of the controller, the measurements of its plant; empty if these have none."""
    controls: tuple[str, ...] = ()
    """Names of its outputs, the controls of its plant; empty if these have none."""

    @property
    def K(self) -> "control.StateSpace":
        """The controller `u = K y` (positive feedback), with the names of its plant's signals; a copy at each call."""
        names = {"inputs": self.measured, "outputs": self.controls}
        return self.lti.to_control(**{kind: list(given) for kind, given in names.items() if given})

    def lines(self) -> list[str]:
        """Return its size, level and norm, then what was checked."""
        size = self.lti.describe_size()
        least = getattr(self, "gamma_opt", None)
        known = [] if least is None else [f"least level: {least:.6g}"]
        where = f" at {self.omega:.4g} rad/s" if np.isfinite(self.omega) else ""
        known += [f"level: {self.gamma:.6g}", f"norm: {self.norm:.6g}{where}"]
        cost = getattr(self, "regularization", 0.0)
        known += [f"regularisation: {cost:.3g}, which adds {self._excess():.3g} to the level"] if cost else []
        signals = [f"signals: {', '.join(self.measured)} to {', '.join(self.controls)}"] if self.measured else []
        return [f"{type(self).__name__}: {size}", *known, *signals, *(f"checked: {each}" for each in self.checks)]

    def _excess(self) -> float:
        return float(getattr(self, "gamma_excess", 0.0))

    @property
    def order(self) -> int:
        """Number of controller states."""
        return self.lti.order


_Result = TypeVar("_Result", bound=CheckedController)


def keep_names(result: _Result, P: Any) -> _Result:
    """Return a controller with the names that its generalised plant gives to measurements and controls."""
    inputs, outputs = signal_names(P)
    y, u = outputs[len(outputs) - result.lti.n_inputs :], inputs[len(inputs) - result.lti.n_outputs :]
    return replace(result, measured=all_or_none(y), controls=all_or_none(u))


@contextmanager
def tell_by_names(P: Any, n_meas: int, n_con: int) -> Iterator[None]:
    """Let errors of a synthesis name controls and measurements as the generalised plant does, where it does."""
    inputs, outputs = signal_names(P)
    known = {"control": inputs[len(inputs) - n_con :], "measurement": outputs[len(outputs) - n_meas :]}

    def name(found: re.Match[str]) -> str:
        names = all_or_none(known[found[1]])
        return f"{found[1]} '{names[int(found[2]) - 1]}'" if names else found[0]

    try:
        yield
    except DesignError as error:
        error.args = (re.sub(r"\b(control|measurement) (\d+)", name, str(error)),)
        raise error from None
