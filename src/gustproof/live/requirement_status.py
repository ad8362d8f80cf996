"""The lights of a flight's requirements: dark until a window is flown to its end, then held or not."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.requirement import Requirement
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.scoring.requirements import judge, requirement_label, requirement_limits


def requirement_status(
    records: NDArray[np.void], scenario: Scenario, vehicle: Vehicle, *, over: bool
) -> list[dict[str, Any]]:
    """Return what the page shows of each requirement after the journal records (n,); none is dark when all is `over`.

    `held` is null for a dark one; `value` [unit of the metric] is null if it is not finite.
    """
    if len(records) < 2:
        values = [(requirement, math.nan, False) for requirement in scenario.require]
    else:
        values = [(each.requirement, each.value, each.is_met) for each in judge(records, scenario, vehicle)]
    return [
        {
            "text": _text(requirement),
            "value": value if math.isfinite(value) else None,
            "held": None if math.isnan(value) and not over else held,
        }
        for requirement, value, held in values
    ]


def _text(requirement: Requirement) -> str:
    end = "end" if requirement.to_s is None else f"{requirement.to_s:g} s"
    return f"{requirement_label(requirement)} {requirement_limits(requirement)}, {requirement.from_s:g} s to {end}"
