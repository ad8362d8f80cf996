"""Margins of a law at hover: the law as it flies, sampled and delayed, on the vehicle's linear model."""

import math
from dataclasses import dataclass, replace

from firmware_model.config.scenario import Scenario, load_scenario, with_measured_delay
from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.hover import hover_plant, is_stable_at_hover, loop_law
from gustproof.errors import DesignError
from gustproof.law.form import Law, Output
from gustproof.law.resample import resample
from gustproof.robust.lti.margins import input_margins
from gustproof.robust.uncertain.uncertainty import Spreads
from gustproof.studies.rate.robustness import (
    RobustnessOverFrequency,
    StabilityRange,
    robust_peak,
    robust_stability,
    robustness_over_frequency,
)

SPREADS = Spreads(inertia=0.2, actuator_lag=0.3)
"""Spreads of the vehicle for `axis_robustness`."""
_WORSE = 1.15
"""[-] most that the sensitivity peak may grow when a law is resampled."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HoverMargins:
    """Worst margins of roll, pitch and yaw, with the loop opened at the plant's input and the other axes closed."""

    Ms: float
    """[-] largest sensitivity."""
    phase_margin_deg: float
    """[deg] least destabilising change of phase."""
    gain_margin: float
    """[-] least destabilising factor above 1."""
    delay_margin: float
    """[s] least destabilising additional delay."""
    unstable_delay: int
    """[samples] least delay, from a measurement to its command's action, at which the loop is unstable."""
    off_nominal_Ms: float | None
    """[-] bound of the largest sensitivity with inertia and lag anywhere within `SPREADS`; `None` if unknown."""


def hover_margins(law: Law, vehicle: Vehicle, scenario: Scenario) -> HoverMargins | None:
    """Return the margins of a torque law at the sample time and delay of `scenario`; `None` for an unstable loop.

    Rate laws give `None` too: they drive the autopilot's own loop, whose margins are not those of the law.

    Examples
    --------
    >>> from gustproof import hover_margins, load_law, load_scenario, load_vehicle
    >>> found = hover_margins(load_law("pid-fair"), load_vehicle("paper"), load_scenario("paper-turbulence"))
    >>> f"Ms {found.Ms:.2f}, {found.phase_margin_deg:.0f} deg"
    'Ms 1.36, 44 deg'
    """
    if not is_stable_at_hover(law, vehicle, scenario):
        return None
    axes = input_margins(hover_plant(vehicle, scenario, with_attitude=law.uses_accelerometer), loop_law(law))
    delay_margin = min(axis.delay_margin for axis in axes)
    return HoverMargins(
        Ms=max(axis.Ms for axis in axes),
        phase_margin_deg=math.degrees(min(axis.phase_margin for axis in axes)),
        gain_margin=min(axis.gain_margin for axis in axes),
        delay_margin=delay_margin,
        unstable_delay=scenario.delay_samples + math.ceil(delay_margin / scenario.dt),
        off_nominal_Ms=_off_nominal_peak(law, vehicle, scenario),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Resampled:
    """A law at another rate, with its margins at hover at either, as late as `hover_scenario` says."""

    law: Law
    """The law at the new rate."""
    before: HoverMargins | None
    """Margins at the law's own rate; `None` for a rates law, whose loop is the autopilot's own."""
    after: HoverMargins | None
    """Margins at the new rate."""


def hover_scenario(vehicle: Vehicle, rate: int) -> Scenario:
    """Return the scenario of margins at hover at `rate` [Hz]: a sample late, and the measured delay if there is one."""
    scenario = load_scenario("paper-turbulence")
    physics = rate * math.ceil(1000 / rate)
    day = replace(scenario, control_rate_hz=rate, physics_rate_hz=physics, delay_samples=1)
    return with_measured_delay(day, vehicle)


def resample_at_hover(law: Law, rate: int, vehicle: Vehicle, *, anyway: bool = False) -> Resampled:
    """Return the law at `rate` [Hz], if its loop at hover is about as good as at its own rate, or `anyway`.

    Raises
    ------
    DesignError
        If the law cannot be resampled, or its loop is unstable or its sensitivity peak over 15 % larger.
    ValueError
        If the rate is none that a scenario may have.
    """
    scenarios = [hover_scenario(vehicle, hz) for hz in (round(1.0 / law.dt), rate)]
    moved = resample(law, rate)
    if law.output is not Output.TORQUE:
        return Resampled(law=moved, before=None, after=None)
    before, after = (hover_margins(each, vehicle, day) for each, day in zip((law, moved), scenarios, strict=True))
    if anyway:
        return Resampled(law=moved, before=before, after=after)
    if after is None:
        raise DesignError(f"law '{law.name}' is unstable on vehicle '{vehicle.name}' at {rate} Hz")
    if before is not None and after.Ms > _WORSE * before.Ms:
        peaks = f"Ms is {after.Ms:.2f}, {before.Ms:.2f} at its own rate"
        raise DesignError(f"law '{law.name}' is poor at {rate} Hz: {peaks}; design it for this rate")
    return Resampled(law=moved, before=before, after=after)


def _off_nominal_peak(law: Law, vehicle: Vehicle, scenario: Scenario) -> float | None:
    try:
        return max(robust_peak(law, vehicle, scenario, SPREADS, axis).upper for axis in range(3))
    except ValueError:  # not three loops of one gyro each, or unstable within the spreads
        return None


def axis_robustness(law: Law, vehicle: Vehicle, scenario: Scenario) -> tuple[StabilityRange, ...]:
    """Return how far inertia and actuator lag may be off for roll, pitch and yaw, as multiples of `SPREADS`.

    At hover the axes share the lag alone, so the least multiple holds for all three inertias and the lag at once. The
    result is empty for a law other than three loops of one gyro each, and for an unstable one.
    """
    try:
        return tuple(robust_stability(law, vehicle, scenario, SPREADS, axis) for axis in range(3))
    except ValueError:
        return ()


def axis_robustness_over_frequency(
    law: Law, vehicle: Vehicle, scenario: Scenario
) -> tuple[RobustnessOverFrequency, ...]:
    """Return mu and the largest sensitivity over frequency for roll, pitch and yaw, under `SPREADS`.

    The result is empty for the laws for which `axis_robustness` is.
    """
    try:
        return tuple(robustness_over_frequency(law, vehicle, scenario, SPREADS, axis) for axis in range(3))
    except ValueError:
        return ()
