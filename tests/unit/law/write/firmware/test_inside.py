import ctypes
import math
import shutil
import subprocess

import numpy as np
import pytest

from firmware_model.numerics.rotations import from_euler
from gustproof.law.form import load_law
from gustproof.law.step import step
from gustproof.law.write.c import AttitudeSource, nearest
from gustproof.law.write.firmware.folders import Firmware

COMPILER = shutil.which("gcc")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
WARNINGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion",
            "-Wfloat-equal", "-Wmissing-prototypes", "-Werror"]  # fmt: skip
DT = 0.004
LEVEL = (1.0, 0.0, 0.0, 0.0)


class Sample(ctypes.Structure):
    _fields_ = [
        ("elapsed", ctypes.c_float),
        ("gyro", ctypes.c_float * 3),
        ("force", ctypes.c_float * 3),
        ("attitude", ctypes.c_float * 4),
        ("age", ctypes.c_float),
        ("reference", ctypes.c_float * 4),
    ]


class Inside:
    """The unit around an exported law, compiled."""

    def __init__(self, files, folder, name: str) -> None:
        self.law = load_law(name)
        sources = []
        for path, text in files.items():
            file = path.rsplit("/", 1)[-1]
            if file in ("gustproof_law.c", "gustproof_law.h", "gustproof_inside.c", "gustproof_inside.h"):
                (folder / file).write_text(text)
                sources += [str(folder / file)] if file.endswith(".c") else []
        library = folder / "inside.so"
        command = [
            COMPILER,
            *WARNINGS,
            "-O2",
            "-ffp-contract=off",
            "-fPIC",
            "-shared",
            *sources,
            "-lm",
            "-o",
            str(library),
        ]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        self._unit = ctypes.CDLL(str(library))
        n = self.law.order

        class State(ctypes.Structure):
            _fields_ = [
                ("x", ctypes.c_double * n),
                ("origin", ctypes.c_double * 3),
                ("waited", ctypes.c_float),
                ("torque", ctypes.c_float * 3),
                ("trim", ctypes.c_float * 3),
            ]

        self.state = State()

    @property
    def x(self) -> np.ndarray:
        return np.array(self.state.x)

    def start(self, **sample) -> None:
        self._unit.gustproof_start(ctypes.byref(self.state), ctypes.byref(self._sample(**sample)))

    def run(self, **sample) -> tuple[int, np.ndarray]:
        torque = (ctypes.c_float * 3)()
        restarted = self._unit.gustproof_run(ctypes.byref(self.state), ctypes.byref(self._sample(**sample)), torque)
        return restarted, np.array(torque)

    def take_over(self, torque) -> None:
        self._unit.gustproof_take_over(ctypes.byref(self.state), (ctypes.c_float * 3)(*torque))

    def undelivered(self, missing) -> None:
        self._unit.gustproof_undelivered(ctypes.byref(self.state), (ctypes.c_float * 3)(*missing))

    @staticmethod
    def _sample(gyro=(0.0,) * 3, force=(0.0, 0.0, -9.81), attitude=LEVEL, reference=LEVEL, elapsed=DT, age=0.0):
        arrays = [(ctypes.c_float * len(each))(*each) for each in (gyro, force, attitude, reference)]
        return Sample(elapsed, arrays[0], arrays[1], arrays[2], age, arrays[3])


@pytest.fixture
def inside(make_folder, tmp_path):
    def make(name: str, attitude: AttitudeSource = AttitudeSource.OWN) -> Inside:
        return Inside(make_folder(Firmware.PX4, name, attitude), tmp_path, name)

    return make


def _rates(count: int) -> np.ndarray:
    return np.random.default_rng(3).normal(0.0, 0.2, (count, 3)).astype(np.float32)


@pytest.mark.parametrize("name", ["flagship", "aided", "hinf-d1"])
def test_torques_are_those_of_the_flown_law_to_the_bit(name, inside):
    unit = inside(name)
    unit.start()
    x, force = np.zeros(unit.law.order), np.array([0.0, 0.0, np.float32(-9.81)])
    for gyro in _rates(300):
        x, command = step(
            unit.law, x, np.concatenate([gyro, np.zeros(3), force])[: 9 if unit.law.uses_accelerometer else 6]
        )
        restarted, torque = unit.run(gyro=gyro)
        assert restarted == 0
        assert torque.tobytes() == command.astype(np.float32).tobytes()
    assert unit.x.tobytes() == x.tobytes()


def test_attitude_of_the_autopilot_takes_the_place_of_the_laws_own(inside):
    unit = inside("flagship", AttitudeSource.AUTOPILOT)
    unit.start()
    x = np.zeros(unit.law.order)
    for k, gyro in enumerate(_rates(50)):
        euler = np.array([0.1, -0.05, 0.02 * k])
        x, command = step(unit.law, x, np.concatenate([gyro, np.zeros(3)]))
        x[:3] = nearest(euler, x[:3])
        _, torque = unit.run(gyro=gyro, attitude=from_euler(*euler))
        np.testing.assert_allclose(torque, command, atol=2e-4)
    np.testing.assert_allclose(unit.x[:3], euler, atol=1e-6)


@pytest.mark.parametrize("name", ["flagship", "pid-fair", "indi"])
def test_law_starts_at_the_present_attitude_and_at_rest_commands_nothing(name, inside):
    unit = inside(name)
    held = from_euler(0.1, -0.2, 3.0)
    unit.start(attitude=held)
    np.testing.assert_allclose(unit.x[:3], [0.1, -0.2, 0.0], atol=1e-6)
    for _ in range(100):
        _, torque = unit.run(attitude=held, reference=held)
        assert np.max(np.abs(torque)) < 1e-3


def test_torque_of_the_loops_before_is_taken_over_and_fades(inside):
    unit = inside("flagship")
    unit.start()
    unit.take_over((0.5, -0.25, math.nan))
    assert not np.any(unit.run()[1])
    unit.take_over((0.5, -0.25, 0.125))
    torques = np.array([unit.run()[1] for _ in range(500)])
    np.testing.assert_allclose(torques[0], [0.5, -0.25, 0.125], rtol=3e-3)
    np.testing.assert_allclose(torques[-1] / torques[0], math.exp(-1.0), rtol=3e-3)
    unit.start()
    assert not np.any(unit.run()[1])


def test_reference_beyond_half_a_turn_is_the_near_one(inside):
    unit = inside("flagship")
    unit.start(attitude=from_euler(0.0, 0.0, 3.1))
    for _ in range(5):
        _, torque = unit.run(attitude=from_euler(0.0, 0.0, 3.1), reference=from_euler(0.0, 0.0, -3.1))
    assert 0.0 < torque[2] < 1.0  # .083 rad onward to the right, not back by a turn


def test_lost_sample_is_made_up_for_by_a_second_step(inside, tmp_path):
    unit = inside("flagship")
    gyro = _rates(1)[0]
    unit.start()
    restarted, torque = unit.run(gyro=gyro, elapsed=2.0 * DT)
    twice = unit.x
    unit.start()
    unit.run(gyro=gyro)
    _, second = unit.run(gyro=gyro)
    assert restarted == 0
    assert torque.tobytes() == second.tobytes()
    assert twice.tobytes() == unit.x.tobytes()


def test_early_sample_waits_and_a_late_one_starts_again(inside):
    unit = inside("flagship")
    unit.start()
    for gyro in _rates(20):
        unit.run(gyro=gyro)
    flown, (_, torque) = unit.x, unit.run(elapsed=0.0, gyro=(1.0, 1.0, 1.0))
    assert unit.x.tobytes() == flown.tobytes()
    assert np.any(torque)
    tilted = from_euler(0.3, 0.0, 0.0)
    restarted, torque = unit.run(elapsed=1.0, attitude=tilted, reference=tilted)
    assert restarted == 1
    assert unit.x[0] == pytest.approx(0.3, abs=1e-6)
    assert np.max(np.abs(torque)) < 1e-3


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_number_that_is_not_finite_starts_the_law_again(bad, inside):
    unit = inside("flagship")
    unit.start()
    restarted, torque = unit.run(gyro=(bad, 0.0, 0.0))
    assert restarted == 1
    assert not np.any(torque)
    for _ in range(3):
        restarted, torque = unit.run()
        assert np.all(np.isfinite(torque))
    assert restarted == 0


def test_age_of_an_attitude_is_bridged_by_the_rates(inside):
    unit = inside("flagship", AttitudeSource.AUTOPILOT)
    unit.start(gyro=(2.0, 0.0, 0.0), attitude=from_euler(0.1, 0.0, 0.5), age=0.004)
    assert unit.x[0] == pytest.approx(0.108, abs=1e-5)
    unit.start(gyro=(0.0, -1.0, 0.0), attitude=from_euler(0.0, 0.1, 0.0), age=0.01)
    assert unit.x[1] == pytest.approx(0.09, abs=1e-5)


def test_what_was_not_delivered_reaches_the_states_of_the_anti_windup(inside):
    unit = inside("flagship")
    unit.start()
    unit.run(gyro=(0.1, 0.0, 0.0))
    before = unit.x
    unit.undelivered((0.5, -0.25, 0.125))
    np.testing.assert_allclose(unit.x - before, unit.law.H @ [0.5, -0.25, 0.125], atol=1e-12)
