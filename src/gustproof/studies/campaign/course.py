"""A course of scenarios that tries a law in all ways, fitted to each vehicle.

Strengths are those for `paper`. Another vehicle flies in gusts that give it the same angular acceleration in roll, and
under moments that are the same share of each axis' torque limit.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from firmware_model.config.events import RotorFailure
from firmware_model.config.files import list_shipped
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle, load_vehicle
from firmware_model.config.waveforms import DirectMoment

COURSE = "course"
"""Name that stands for all its scenarios."""
_DATA = Path(__file__).parent / "course_data"


def load_course(vehicle: Vehicle) -> list[Scenario]:
    """Return the scenarios in strengths for a vehicle, without those whose failed rotors leave it no hover."""
    course = (load_scenario(_DATA / f"{name}.toml") for name in list_shipped(_DATA, ".toml"))
    return [fit_scenario(each, vehicle) for each in course if _can_hover(each, vehicle)]


def fit_scenario(scenario: Scenario, vehicle: Vehicle) -> Scenario:
    """Return a scenario for `paper` in strengths for another vehicle."""
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
