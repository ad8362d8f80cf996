"""Nearest case in which a law's loop is unstable: a vehicle within its spreads, beyond them, or more delay; flown."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.law.form import Law
from gustproof.robust.lti.state_space import lft
from gustproof.studies.rate.plant_box import PlantBox, describe_vehicle
from gustproof.studies.rate.robustness import robust_stability

LOST_DEG = 60.0
"""[deg] roll or pitch beyond which attitude counts as lost."""
_BEYOND = 1.1
"""[-] share by which a case lies beyond the edge of stability: its oscillation grows within the flight."""
_MOST_DELAY = 50
"""[samples] most delay of a scenario."""
_LEAST = 0.05
"""[-] least inertia and lag of a case, as a share of the middle of the spreads."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FailureCase:
    """Flight of an unstable loop, beside that of the nominal vehicle in the same air."""

    change: str
    """Difference to the nominal flight, in words."""
    scenario: Scenario
    """Script."""
    vehicle: Vehicle
    """Vehicle."""
    figures: Metrics
    """Figures of the flight."""
    nominal: Metrics
    """Figures of the nominal flight."""

    def describe(self) -> str:
        """Return the flight in one line."""
        flown, usual = self.figures, self.nominal
        end = f"peak {flown.peak_deg:.3g} deg" if is_held(flown) else "attitude is lost"
        cost = f"torque slew {flown.torque_slew_rms:.3g} N m/s, {flown.saturated_s:.3g} s at a torque limit"
        other = f"peak {usual.peak_deg:.3g} deg, slew {usual.torque_slew_rms:.3g} N m/s"
        return f"{self.change}, flown {self.scenario.duration_s:g} s: {end}, {cost}; the nominal flight: {other}"


def is_held(figures: Metrics) -> bool:
    """Return True if roll and pitch stayed within `LOST_DEG`."""
    return max(figures.peak_roll_deg, figures.peak_pitch_deg) <= LOST_DEG  # False for NaN too


class Instability(NamedTuple):
    """Nearest unstable vehicle found by search over the lag and the inertia of one axis."""

    times: float
    """[-] multiple of the spreads that has it on its edge; at most 1 is within them."""
    centre: Vehicle
    """Vehicle in the middle of the spreads."""
    axis: int
    """Axis, 0 to 2."""
    inertia: float
    """[-] deviation of the axis' inertia from the middle."""
    lag: float
    """[-] deviation of the lag."""

    def vehicle(self, share: float = 1.0) -> Vehicle:
        """Return the vehicle at `share` times its deviations."""
        moments = list(self.centre.inertia_B)
        moments[self.axis] *= max(1.0 + share * self.inertia, _LEAST)
        x, y, z = moments
        lag = self.centre.actuator_lag * max(1.0 + share * self.lag, _LEAST)
        return replace(self.centre, inertia_B=(x, y, z), actuator_lag=lag)


def spectral_radius(law: Law, vehicle: Vehicle, scenario: Scenario) -> float:
    """Return the largest modulus of the loop's poles at hover; the loop is stable below 1."""
    closed = lft(hover_plant(vehicle, scenario, with_attitude=law.uses_accelerometer), loop_law(law))
    return float(np.max(np.abs(closed.poles())))


def nearest_instability(law: Law, box: PlantBox, scenario: Scenario) -> Instability | None:
    """Return the unstable vehicle of the least multiple of the spreads; `None` if none is found."""
    nearest = None
    for axis in range(3):
        centre, spreads = box.centre(axis)
        try:
            member = robust_stability(law, centre, scenario, spreads, axis).unstable
        except ValueError:  # not a loop of one gyro, no spread, or the middle itself is unstable: a corner tells it
            continue
        if member is not None and (nearest is None or member.times < nearest.times):
            nearest = Instability(member.times, centre, axis, member.inertia, member.actuator_lag)
    return nearest


def fly_failure(
    law: Law,
    box: PlantBox,
    unstable: Sequence[Vehicle],
    edge: Instability | None,
    delays: tuple[float, float],
    scenario: Scenario,
    seed: int,
) -> FailureCase | None:
    """Fly the most unstable vehicle within the spreads or, without one, the nearest unstable case beyond them.

    `delays` [s] are the delay margin and the least one allowed. A case of delay is as near as their ratio, a vehicle
    as its multiple of the spreads. The result is `None` without any case.
    """
    found = _nearest_case(law, box, unstable, edge, delays, scenario)
    if found is None:
        return None
    change, vehicle, script = found
    nominal = box.nominal
    return FailureCase(
        change=change,
        scenario=script,
        vehicle=vehicle,
        figures=measure(fly_direct(script, law, vehicle=vehicle, seed=seed), vehicle, script, law=law),
        nominal=measure(fly_direct(scenario, law, vehicle=nominal, seed=seed), nominal, scenario, law=law),
    )


def _nearest_case(
    law: Law,
    box: PlantBox,
    unstable: Sequence[Vehicle],
    edge: Instability | None,
    delays: tuple[float, float],
    scenario: Scenario,
) -> tuple[str, Vehicle, Scenario] | None:
    """Return the case in words, its vehicle and its script."""
    if unstable:
        worst = max(unstable, key=lambda each: spectral_radius(law, each, scenario))
        nominal = worst == box.nominal
        return "nominal vehicle" if nominal else f"within the spreads: {describe_vehicle(worst)}", worst, scenario
    cases = []
    margin, least = delays
    late = math.ceil(_BEYOND * margin / scenario.dt) if math.isfinite(margin) else 0
    slow = replace(scenario, delay_samples=min(scenario.delay_samples + late, _MOST_DELAY))
    if late and spectral_radius(law, box.nominal, slow) >= 1.0:
        cases.append((margin / least, (f"{1e3 * late * scenario.dt:.3g} ms more of delay", box.nominal, slow)))
    if edge is not None:
        beyond = edge.vehicle(_BEYOND)
        what = f"{_BEYOND * edge.times:.3g} times the spreads: {describe_vehicle(beyond)}"
        cases.append((edge.times, (what, beyond, scenario)))
    return min(cases, key=lambda case: case[0])[1] if cases else None
