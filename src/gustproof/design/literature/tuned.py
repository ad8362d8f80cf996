"""Baselines tuned for a vehicle: the least predicted attitude error at a sensitivity peak and a torque slew.

The procedure is that of `gustproof.design.tune`, and the same for all of them. Gains are searched by sequential
quadratic programming from fixed starts; peaks are limited too at the corners of the vehicle's spreads.
"""

from pkgutil import resolve_name
from typing import Any

from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from gustproof.design.autopilot_gains import tune_gains
from gustproof.design.literature.structure import AxisStructure
from gustproof.design.structures import BASELINES
from gustproof.design.tune import (
    SENSITIVITY_PEAK,
    Progress,
    Tuning,
    check_limits,
    find_law,
    judge_tuned,
    make_task,
)

_ROUNDED = 1e-4
"""[-] share of the slew reserved for parameters of an autopilot, which have five digits."""


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

    The limits are those of `gustproof.design.tune.tune_law`. The cascades of PX4 and ArduPilot run at the scenario's
    rate, with their own filters and within the gains that ground stations take.

    Raises
    ------
    DesignError
        If there is no such law.
    ValueError
        If there is no baseline of that name.
    """
    if name not in BASELINES:
        raise ValueError(f"no baseline '{name}'")
    task = make_task(name, vehicles, scenario, slew=slew, sensitivity_peak=sensitivity_peak, progress=progress)
    if (where := BASELINES[name]) is not None:
        structure: AxisStructure[Any] = resolve_name(f"gustproof.design.literature.{where}")
        return judge_tuned(task, *find_law(task, structure.make, is_quick=False))
    progress(0.1, "least error")
    law = tune_gains(
        name,
        vehicles,
        scenario,
        slew=(1.0 - _ROUNDED) * task.limits.slew,
        sensitivity_peak=sensitivity_peak,
        in_simulation=False,
    ).law
    check_limits(task, law, task.limits)
    return judge_tuned(task, law, task.limits)
