import signal
import threading
import time

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.flight.controllers import stepper
from gustproof.flight.controllers.stepper import StepError, StepFault, make_stepper
from gustproof.flight.controllers.time_limit import TimeLimitExceeded, time_limit
from gustproof.flight.controllers.user_controller import parse_controller

VEHICLE = load_vehicle("paper")
INPUTS = np.ones(3), np.zeros(3), np.zeros(3), 0.004
BODY = """
class Mine:
    def __init__(self, vehicle=None):
        self.vehicle = vehicle
    def reset(self):
        pass
    def step(self, gyro, reference, force, dt):
        {step}
{make}
"""


@pytest.fixture
def entry(tmp_path):
    def write(step: str = "return -gyro", make: str = "make = Mine"):
        file = tmp_path / "mine.py"
        file.write_text(BODY.format(step=step, make=make))
        return parse_controller(f"{file}:make")

    return write


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        ("make = Mine", VEHICLE.name),
        ("make = lambda: Mine()", None),
        ("make = lambda craft: Mine(craft)", VEHICLE.name),
        ("make = lambda gain=1.0: Mine()", None),
        ("make = lambda *rest: Mine(*rest)", None),
    ],
)
def test_a_maker_gets_the_vehicle_if_it_takes_one(entry, make, expected):
    made = make_stepper(entry(make=make), VEHICLE)
    assert getattr(made._stepper.vehicle, "name", None) == expected
    assert made.step(*INPUTS) == (-1.0, -1.0, -1.0)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        ("make = 3", "has no function 'make'"),
        ("make = lambda: 1 / 0", r"make\(\) raised ZeroDivisionError: division by zero \(mine.py:9\)"),
        ("make = dict", r"returned a dict without reset\(\)"),
        ("make = lambda: exit(4)", r"make\(\) raised SystemExit: 4"),
        ("import no_such_module", r"import raised ModuleNotFoundError: .* \(mine.py:9\)"),
        ("make = (", r"import raised SyntaxError: .* \(mine.py:9\)"),
    ],
)
def test_a_controller_that_cannot_be_made_is_bad_input(entry, make, complaint):
    with pytest.raises(ConfigError, match=complaint):
        make_stepper(entry(make=make), VEHICLE)


def test_modules_beside_the_file_can_be_imported(entry, tmp_path):
    (tmp_path / "beside_it.py").write_text("gain = 2.0\n")
    assert make_stepper(entry("return -gain * gyro", "from beside_it import gain\nmake = Mine"), VEHICLE)


@pytest.mark.parametrize(
    ("step", "fault", "words"),
    [
        ("return 1 / 0", StepFault.RAISED, r"controller 'mine': step\(\) raised ZeroDivisionError: .* \(mine.py:8\)"),
        ("raise SystemExit(1)", StepFault.RAISED, "SystemExit"),
        ("return gyro[:2]", StepFault.RAISED, r"shape \(2,\) of float64, must be three numbers"),
        ("return None", StepFault.RAISED, r"shape \(\) of object"),
        ("return '123', '1', '2'", StepFault.RAISED, r"shape \(3,\) of <U3"),
        ("return [[1], [2, 3], 4]", StepFault.RAISED, "ValueError"),
        ("return 0.0, float('nan'), 0.0", StepFault.NOT_FINITE, "0, nan, 0 N m"),
        ("return gyro / 0.0", StepFault.NOT_FINITE, "inf, inf, inf"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero")
def test_a_step_that_fails_names_its_fault_and_place(entry, step, fault, words):
    with pytest.raises(StepError, match=words) as caught:
        make_stepper(entry(step), VEHICLE).step(*INPUTS)
    assert caught.value.fault is fault
    assert "\n" not in str(caught.value)


def test_a_step_that_hangs_is_interrupted_even_if_it_catches_errors(entry, monkeypatch):
    monkeypatch.setattr(stepper, "STEP_LIMIT_S", 0.05)
    hanging = make_stepper(
        entry("import time\n        try:\n            time.sleep(60)\n        except Exception: pass"), VEHICLE
    )
    with pytest.raises(StepError, match=r"longer than 0\.05 s") as caught, hanging.limit_time():
        hanging.step(*INPUTS)
    assert caught.value.fault is StepFault.HUNG


def test_a_controller_is_not_blamed_for_time_between_its_steps(entry, monkeypatch):
    monkeypatch.setattr(stepper, "STEP_LIMIT_S", 0.02)
    quick = make_stepper(entry(), VEHICLE)
    with quick.limit_time():
        quick.step(*INPUTS)
        time.sleep(0.1)


def test_a_time_limit_leaves_the_alarm_as_it_was():
    earlier = signal.getsignal(signal.SIGALRM), signal.getitimer(signal.ITIMER_REAL)[0]
    with pytest.raises(TimeLimitExceeded), time_limit(0.01):
        time.sleep(1.0)
    left_s = signal.getitimer(signal.ITIMER_REAL)[0]
    assert signal.getsignal(signal.SIGALRM) == earlier[0]
    assert (left_s > 0.0) == (earlier[1] > 0.0)


def test_another_thread_has_no_time_limit():
    ended = []

    def run():
        with time_limit(0.001):
            time.sleep(0.05)
        ended.append(True)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert ended
