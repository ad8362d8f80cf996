from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.entries import stepper
from gustproof.entries.entry import parse_entry
from gustproof.law.form import load_law
from gustproof.simulate.direct import fly_direct
from gustproof.simulate.outcome import FlightOutcome
from gustproof.simulate.pilots import fly_pilot

VEHICLE = load_vehicle("paper")
SHORT = replace(load_scenario("paper-turbulence"), duration_s=0.1)
LAW = load_law("hinf-scheduled")
SAME_LAW = """
import numpy as np
from gustproof import load_law
from gustproof.law.step import step

class Same:
    def reset(self):
        self.x = np.zeros(self.law.order)
    def step(self, gyro, reference, force, dt):
        self.x, torque = step(self.law, self.x, np.concatenate([gyro, reference, force]))
        gyro[:] = reference[:] = np.nan  # its own copies
        return torque

def make():
    made = Same()
    made.law = load_law("hinf-scheduled")
    return made
"""
FAILING = """
class Failing:
    def reset(self):
        self.samples = 0
    def step(self, gyro, reference, force, dt):
        self.samples += 1
        if self.samples == 11:
            {end}
        return 0.0, 0.0, 0.0
make = Failing
"""


@pytest.fixture
def entry(tmp_path):
    def write(text: str):
        (tmp_path / "mine.py").write_text(text)
        return parse_entry(f"{tmp_path}/mine.py:make")

    return write


@pytest.mark.parametrize("delay", [0, 2])
def test_a_python_object_flies_the_bits_of_the_law_that_it_computes(entry, delay):
    scenario = replace(SHORT, delay_samples=delay)
    flown = fly_pilot(scenario, entry(SAME_LAW), vehicle=VEHICLE, seed=3)
    assert flown.outcome is FlightOutcome.DONE
    assert flown.records.tobytes() == fly_direct(scenario, LAW, vehicle=VEHICLE, seed=3).tobytes()


@pytest.mark.parametrize(
    ("end", "outcome", "words"),
    [
        ("raise ValueError('lost')", FlightOutcome.CONTROLLER_RAISED, "raised ValueError: lost (mine.py:8)"),
        ("return 0.0, 0.0, float('nan')", FlightOutcome.CONTROLLER_NOT_FINITE, "0, 0, nan N m"),
        ("import time; time.sleep(60)", FlightOutcome.CONTROLLER_HUNG, "longer than 0.05 s"),
    ],
)
def test_a_controller_that_fails_leaves_its_records_and_a_named_end(entry, monkeypatch, end, outcome, words):
    monkeypatch.setattr(stepper, "STEP_LIMIT_S", 0.05)
    flown = fly_pilot(SHORT, entry(FAILING.format(end=end)), vehicle=VEHICLE)
    assert flown.outcome is outcome
    assert words in flown.message
    assert len(flown.records) == 10
    assert np.isfinite(flown.records["torque_command_B"]).all()


def test_a_maker_gets_the_nominal_vehicle_not_the_flown_one(entry):
    text = (
        FAILING.format(end="pass") + "\ndef make(vehicle):\n    assert vehicle.name == 'iris'\n    return Failing()\n"
    )
    flown = fly_pilot(SHORT, entry(text), vehicle=VEHICLE, nominal=load_vehicle("iris"))
    assert flown.outcome is FlightOutcome.DONE
