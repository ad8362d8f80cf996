"""Margins that a flying law has at hover: the law as it flies, sampled and late, on the vehicle's linear model."""

import math
from dataclasses import dataclass

from firmware_model.scenario import Scenario
from firmware_model.vehicle import Vehicle
from gustproof.law import Law, Output
from gustproof.model.lpv import linear_plant
from gustproof.numerics.lti import Lti, delay, hold_discretized, series
from gustproof.numerics.margins import margins
from gustproof.synthesis.discretize import linear_law


@dataclass(frozen=True, slots=True, kw_only=True)
class HoverMargins:
    """The worst of roll, pitch and yaw, with the loop cut at the plant's input and the other axes closed."""

    Ms: float
    """[-] largest sensitivity."""
    phase_margin_deg: float
    """[deg] least change of phase that destabilises."""
    delay_margin: float
    """[s] least additional delay that destabilises."""


def hover_margins(law: Law, vehicle: Vehicle, scenario: Scenario) -> HoverMargins | None:
    """Return the margins of a torque law at the sample time and delay of `scenario`; `None` for a law of rates.

    What a law of rates drives is the autopilot's own loop, whose margins are not those of the law.
    """
    if law.output is not Output.TORQUE:
        return None
    axes = margins(hover_plant(vehicle, scenario), linear_law(law)).input
    return HoverMargins(
        Ms=max(axis.Ms for axis in axes),
        phase_margin_deg=math.degrees(min(axis.phase_margin for axis in axes)),
        delay_margin=min(axis.delay_margin for axis in axes),
    )


def hover_plant(vehicle: Vehicle, scenario: Scenario) -> Lti:
    """Return torque command (3,) [N*m] to gyro (3,) [rad/s] at hover, sampled and delayed as `scenario` has it.

    The attitude, which no gyro sees, is left out: rates, damping, actuators and commands on their way are the states.
    """
    full = linear_plant(vehicle)
    rates = Lti(A=full.A[3:, 3:], B=full.B[3:, :3], C=full.C[3:, 3:], D=full.D[3:, :3])
    plant = hold_discretized(rates, scenario.dt)
    for _ in range(scenario.delay_samples):
        plant = series(delay(3, scenario.dt), plant)
    return plant
