import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import MomentStep
from gustproof.flight.controllers import stepper
from gustproof.flight.controllers.stepper import make_stepper
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.routes.batch import Case, fly_many
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.direct import fly_direct, fly_stepper
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.law.form import load_law
from gustproof.law.write.c import save_c

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


COMPILERS = [
    pytest.param(name, marks=pytest.mark.skipif(shutil.which(name) is None, reason=f"needs {name}"))
    for name in ("gcc", "clang")
]
LOST = """
const struct { int numbers[5]; double dt, limits[3]; const char *name; } mine_facts = { {1, 6, 8, 0, 0}, 0.004 };
void mine_init(double *x) { x[0] = 0.0; }
int mine_step(double *x, double *y, double *u)
{
    u[0] = u[1] = 0.0;
    u[2] = x[0] == 10.0 ? 0.0 / 0.0 : 0.0;
    x[0]++;
    return 0;
}
"""


def compile_library(compiler: str, source: Path):
    out = source.with_suffix(f".{compiler}.so")
    subprocess.run([compiler, "-O3", "-march=native", "-shared", "-fPIC", source, "-o", out], check=True)
    return parse_controller(str(out))


@pytest.fixture
def entry(tmp_path):
    def write(text: str):
        (tmp_path / "mine.py").write_text(text)
        return parse_controller(f"{tmp_path}/mine.py:make")

    return write


@pytest.mark.parametrize("delay", [0, 2])
def test_a_python_object_flies_the_bits_of_the_law_that_it_computes(entry, delay):
    scenario = replace(SHORT, delay_samples=delay)
    flown = fly_controller(scenario, entry(SAME_LAW), vehicle=VEHICLE, seed=3)
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
    flown = fly_controller(SHORT, entry(FAILING.format(end=end)), vehicle=VEHICLE)
    assert flown.outcome is outcome
    assert words in flown.message
    assert len(flown.records) == 10
    assert np.isfinite(flown.records["torque_command_B"]).all()


def test_a_maker_gets_the_nominal_vehicle_not_the_flown_one(entry):
    text = (
        FAILING.format(end="pass") + "\ndef make(vehicle):\n    assert vehicle.name == 'iris'\n    return Failing()\n"
    )
    flown = fly_controller(SHORT, entry(text), vehicle=VEHICLE, nominal=load_vehicle("iris"))
    assert flown.outcome is FlightOutcome.DONE


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("name", ["flagship", "hinf-rates"])
def test_exported_c_flies_the_bits_of_its_law(tmp_path, compiler, name):
    save_c(load_law(name), tmp_path / "law.c")
    library = compile_library(compiler, tmp_path / "law.c")
    flown = fly_controller(SHORT, library, vehicle=VEHICLE, seed=3)
    records = fly_direct(SHORT, load_law(name), vehicle=VEHICLE, seed=3)
    assert flown.records.tobytes() == records.tobytes()
    by_object, failure = fly_stepper(SHORT, make_stepper(library, VEHICLE), vehicle=VEHICLE, seed=3)
    assert failure is None
    assert by_object.tobytes() == records.tobytes()


@pytest.mark.parametrize("compiler", COMPILERS)
def test_exported_c_flies_in_lanes_with_the_bits_of_its_law(tmp_path, compiler, turn):
    kick = MomentStep(kind="step", amplitude_nm=(2.0, 17.0, 3.0), start_s=0.1)  # over the vertical
    scenario = replace(SHORT, duration_s=1.0, moment=(kick,))
    cases = [Case(vehicle=VEHICLE, seed=seed, gust_scale=0.1 * seed) for seed in range(40)]
    turned = turn(load_law("hinf-d1"), 0.1)  # linear at rest
    for law in (load_law("flagship"), turned, load_law("hinf-rates")):
        source = tmp_path / f"{law.name}.c"
        save_c(law, source)
        assert fly_many(scenario, compile_library(compiler, source), cases) == fly_many(scenario, law, cases)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_c_that_commands_nan_ends_by_name(tmp_path):
    (tmp_path / "lost.c").write_text(LOST)
    flown = fly_controller(SHORT, compile_library("gcc", tmp_path / "lost.c"), vehicle=VEHICLE)
    assert flown.outcome is FlightOutcome.CONTROLLER_NOT_FINITE
    assert len(flown.records) == 10
    assert "commanded 0, 0, nan" in flown.message
