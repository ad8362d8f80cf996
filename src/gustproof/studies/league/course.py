"""The league's course: fixed scenarios, fitted to each vehicle.

A scenario's first requirement on the error of all axes together gives the window of the score; its limit is the largest
error that counts. Strengths are those for `paper`. Another vehicle flies in gusts that give it the same angular
acceleration in roll, and under moments that are the same share of each axis' torque limit.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from firmware_model.config.events import RotorFailure
from firmware_model.config.files import list_shipped
from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle, load_vehicle
from firmware_model.config.waveforms import DirectMoment

_DATA = Path(__file__).parent / "data"
COURSE = list_shipped(_DATA, ".toml")
"""Names of the scenarios."""
FLEET = ("paper", "octo", "iris")
"""Names of the vehicles."""
WORST_DEG = 60.0
"""[deg] error that counts for a flight that diverged or broke off, and the largest that counts for any."""


def load_course(names: Sequence[str] = COURSE) -> list[Scenario]:
    """Return scenarios by name, or from files, each with the requirement that gives its score alone.

    Raises
    ------
    ConfigError
        If there is no such scenario, or its file is wrong.
    """
    return [_keep_score(load_scenario(_DATA / f"{name}.toml" if name in COURSE else name)) for name in names]


def _keep_score(scenario: Scenario) -> Scenario:
    scored = [each for each in scenario.require if each.metric is Metric.RMSE and each.axis is None]
    whole = Requirement(metric=Metric.RMSE, at_most=WORST_DEG)
    return replace(scenario, require=(replace((scored or [whole])[0], at_most=WORST_DEG),))


def fit_scenario(scenario: Scenario, vehicle: Vehicle) -> Scenario | None:
    """Return the scenario in strengths for the vehicle; `None` if its failed rotors leave no hover."""
    if not _can_hover(scenario, vehicle):
        return None
    paper = load_vehicle("paper")
    gusts = (paper.gust_gain / paper.inertia_B[0]) / (vehicle.gust_gain / vehicle.inertia_B[0])
    shares = np.array(vehicle.torque_limit) / np.array(paper.torque_limit)
    moments = []
    for item in scenario.moment:
        if isinstance(item, DirectMoment):
            L, M, N = (shares * item.amplitude_nm).tolist()
            item = replace(item, amplitude_nm=(L, M, N))
        moments.append(item)
    return replace(scenario, gust_scale=gusts * scenario.gust_scale, moment=tuple(moments))


def _can_hover(scenario: Scenario, vehicle: Vehicle) -> bool:
    """Return whether rotors of the shares that failures leave give the weight without any torque."""
    rotors = vehicle.rotors
    most = [rotors.thrust_max] * rotors.count
    for item in scenario.event:
        if isinstance(item, RotorFailure):
            if item.rotor > rotors.count:
                return False
            most[item.rotor - 1] *= item.share
    wrench = np.array([0.0, 0.0, 0.0, GRAVITY * vehicle.mass])
    bounds = [(0.0, thrust) for thrust in most]
    return bool(scipy.optimize.linprog(np.ones(rotors.count), A_eq=rotors.wrench, b_eq=wrench, bounds=bounds).success)
