"""A controller that its closed loop vouches for: the result of every synthesis."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gustproof.robust.lti.state_space import Lti

if TYPE_CHECKING:
    import control

ROUNDING_ERRORS = (np.linalg.LinAlgError, OverflowError)
"""Errors by which arithmetic gives up."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckedController:
    """A controller with its level, and the norm of the loop that it closes, computed from that loop alone."""

    controller: Lti
    """`u = K y` (positive feedback)."""
    gamma: float
    """[-] level of the design, in the method's own measure."""
    norm: float
    """[-] norm of the closed loop that was checked; at most `gamma`."""
    omega: float
    """[rad/s] frequency of that norm."""
    checks: tuple[str, ...] = ()
    """Checks of the closed loop that were passed, a sentence each."""

    @property
    def K(self) -> "control.StateSpace":
        """The controller for python-control, a copy at each call."""
        return self.controller.to_control()

    @property
    def order(self) -> int:
        """Number of controller states."""
        return self.controller.order
