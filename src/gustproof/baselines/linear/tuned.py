"""Baselines tuned for a vehicle: the least predicted attitude error at a sensitivity peak and a torque slew.

The procedure is that of `gustproof.synthesis.tune`, and the same for all of them. Gains are searched by sequential
quadratic programming from fixed starts; peaks are limited too at the corners of the vehicle's spreads.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from gustproof.baselines.linear.adrc import ADRC
from gustproof.baselines.linear.dob import DOB
from gustproof.baselines.linear.l1 import L1
from gustproof.baselines.linear.loop_shaping import LOOP_SHAPING
from gustproof.baselines.linear.lqg import LQG
from gustproof.baselines.linear.structure import Structure
from gustproof.synthesis.autopilot_gains import tune_gains
from gustproof.synthesis.tune import (
    SENSITIVITY_PEAK,
    Progress,
    Tuning,
    check_price,
    find_law,
    judge_tuned,
    make_task,
)

_ROUNDED = 1e-4
"""[-] share of the slew reserved for parameters of an autopilot, which have five digits."""


class BaselineKind(StrEnum):
    """Law of the literature."""

    LQG = "lqg"
    """Linear-quadratic-Gaussian control with loop transfer recovery."""
    LOOP_SHAPING = "loop-shaping"
    """H-infinity loop shaping."""
    ADRC = "adrc"
    """Active disturbance rejection control with an extended state observer."""
    L1 = "l1"
    """L1 adaptive control with piecewise-constant adaptation."""
    DOB = "dob"
    """Disturbance observer around a PD law."""
    PX4 = "px4"
    """PX4's cascade."""
    ARDUPILOT = "ardupilot"
    """ArduPilot's cascade."""


_STRUCTURES: Mapping[BaselineKind, Structure[Any]] = {
    BaselineKind.LQG: LQG,
    BaselineKind.LOOP_SHAPING: LOOP_SHAPING,
    BaselineKind.ADRC: ADRC,
    BaselineKind.L1: L1,
    BaselineKind.DOB: DOB,
}


def tune_baseline(
    name: str,
    vehicles: VehicleSet,
    scenario: Scenario,
    *,
    slew: float | None = None,
    sensitivity_peak: float = SENSITIVITY_PEAK,
    progress: Progress = lambda _fraction, _text: None,
) -> Tuning:
    """Return a baseline with the least predicted error for the vehicle in the scenario's turbulence.

    The limits are those of `gustproof.synthesis.tune.tune_law`. The cascades of PX4 and ArduPilot run at the scenario's
    rate, with their own filters and within the gains that ground stations take.

    Raises
    ------
    DesignError
        If there is no such law.
    ValueError
        If there is no baseline of that name.
    """
    kind = BaselineKind(name)
    task = make_task(kind, vehicles, scenario, slew=slew, sensitivity_peak=sensitivity_peak, progress=progress)
    if kind in _STRUCTURES:
        return judge_tuned(task, *find_law(task, _STRUCTURES[kind].make, is_quick=False))
    progress(0.1, "least error")
    law = tune_gains(
        kind,
        vehicles,
        scenario,
        slew=(1.0 - _ROUNDED) * task.limits.slew,
        sensitivity_peak=sensitivity_peak,
        in_simulation=False,
    ).law
    check_price(task, law, task.limits)
    return judge_tuned(task, law, task.limits)
