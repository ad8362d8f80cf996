"""The loop by which the vehicle holds its place around a law, linear at hover: its peak, and slower gains."""

import math
from dataclasses import replace

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import PositionLoop, Vehicle
from gustproof.airframe.hover import reference_loop
from gustproof.airframe.lpv import linear_plant
from gustproof.law.form import Law, Output
from gustproof.robust.lti.state_space import Lti, delay, discretize_zoh, sensitivity, series

GOOD_PEAK = 2.0
"""[-] largest sensitivity that slower gains are chosen for."""
_SLOWER, _TRIES = 0.8, 20
_GROWTH = 1e-3  # [1/s] of a mode that counts; what the gyro can't tell, the law's level and heading, stays where it is
_RATES = np.geomspace(0.01, 100.0, 1000)  # [rad/s]


def place_peak(law: Law, vehicle: Vehicle, scenario: Scenario, gains: PositionLoop) -> float | None:
    """Return the largest sensitivity [-] of the position loop around a law, the worse of roll and pitch.

    It is infinite if the loop is unstable. It is `None` of a law that commands rates or reads the accelerometer: no
    linear model knows how that one tracks. The air's drag, which damps, is left out.
    """
    if law.output is not Output.TORQUE or law.uses_accelerometer:
        return None
    tracking, outer = _tracking(law, vehicle, scenario), _outer_loop(gains, law.dt)
    peaks = list[float]()
    for axis in range(2):
        one = slice(axis, axis + 1)
        loop = series(tracking.subsystem(one, one), outer)
        grows = np.abs(np.linalg.eigvals(sensitivity(loop).A)).max() > 1.0 + _GROWTH * law.dt
        peaks.append(math.inf if grows else float(np.max(1.0 / np.abs(1.0 + loop.response(_RATES)))))
    return max(peaks)


def slow_down(law: Law, vehicle: Vehicle, scenario: Scenario) -> PositionLoop | None:
    """Return the fastest of ever slower horizontal gains whose peak is at most `GOOD_PEAK`; `None` if none is."""
    gains = vehicle.position
    for k in range(_TRIES):
        share = _SLOWER**k
        slower = replace(
            gains,
            xy_p=round(share * gains.xy_p, 4),
            xy_velocity_p=round(share * gains.xy_velocity_p, 4),
            xy_velocity_i=round(share**2 * gains.xy_velocity_i, 4),
        )
        peak = place_peak(law, vehicle, scenario, slower)
        if peak is not None and peak <= GOOD_PEAK:
            return slower
    return None


def _tracking(law: Law, vehicle: Vehicle, scenario: Scenario) -> Lti:
    """Return the closed attitude loop from the reference (3,) to the attitude (3,) [rad]."""
    plant = linear_plant(vehicle)
    sampled = discretize_zoh(plant.subsystem(slice(None), slice(0, 3)), law.dt)
    for _ in range(scenario.delay_samples):
        sampled = series(delay(3, law.dt), sampled)
    return reference_loop(law, sampled)


def _outer_loop(gains: PositionLoop, dt: float) -> Lti:
    """Return tilt to minus the tilt that the position loop asks for: gravity, twice integrated, then P and PI."""
    p, i = gains.xy_velocity_p, gains.xy_velocity_i
    A = [[1.0, 0.0, 0.0], [dt, 1.0, 0.0], [dt * i, dt * i * gains.xy_p, 1.0]]
    return Lti(A=A, B=[[dt], [0.0], [0.0]], C=[[p, p * gains.xy_p, 1.0]], D=[[0.0]], dt=dt)
