"""Status of a flight's requirements on the live page: dark until a window is flown, then held or not."""

import math
from typing import Any

from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.flight.scoring.requirements import judge, requirement_limits, requirement_name, requirement_unit
from gustproof.types import Records


def requirement_status(
    records: Records, scenario: Scenario, vehicle: Vehicle, *, over: bool, law: object = None
) -> list[dict[str, Any]]:
    """Return the status of each requirement after the journal `records` (n,); none is dark once the flight is `over`.

    `held` is null for a dark one. `value` has the unit of the text, and is null if it is not finite.
    """
    if len(records) < 2:
        values = [(requirement, math.nan, False) for requirement in scenario.require]
    else:
        values = [(each.requirement, each.value, each.is_met) for each in judge(records, scenario, vehicle, law=law)]
    return [
        {
            "text": _text(requirement),
            # the share of the envelope is shown in percent
            "value": value * (100.0 if requirement.metric is Metric.RHO else 1.0) if math.isfinite(value) else None,
            "held": None if math.isnan(value) and not over else held,
        }
        for requirement, value, held in values
    ]


def _text(requirement: Requirement) -> str:
    end = "end" if requirement.to_s is None else f"{requirement.to_s:g} s"
    whole = requirement.from_s == 0.0 and requirement.to_s is None
    window = "" if whole else f", {requirement.from_s:g} s to {end}"
    if requirement.metric is Metric.RHO:
        limits = (("≥", requirement.at_least), ("≤", requirement.at_most))
        shares = " ".join(f"{sign} {100.0 * limit:g} %" for sign, limit in limits if limit is not None)
        return f"envelope used {shares}{window}"
    if requirement.metric is Metric.SATURATED and requirement.at_most == 0.0:
        return f"torque never saturated{window}"
    return f"{requirement_name(requirement)} {requirement_limits(requirement)} {requirement_unit(requirement)}{window}"
