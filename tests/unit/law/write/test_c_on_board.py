"""The C unit as an autopilot calls it: start, alignment, limits, time, C++, single precision, ARM, cost."""

import ctypes
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gustproof.law.form import list_laws, load_law
from gustproof.law.resample import resample
from gustproof.law.step import STEEP, step
from gustproof.law.write.c import AttitudeSource, c_name, c_unit, nearest, resting_states, save_c
from gustproof.law.write.operations import INSTRUCTIONS, count_operations
from gustproof.law.write.single import SingleLaw, sin_versine, single_number, split

COMPILER = shutil.which("cc") or shutil.which("gcc")
WARNINGS = [
    "-pedantic",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wshadow",
    "-Wdouble-promotion",
    "-Wfloat-equal",
    "-Wmissing-declarations",
    "-Werror",
]
LANGUAGES = {
    "gcc": ["-std=c99", "-Wmissing-prototypes", "-Wstrict-prototypes"],
    "clang": ["-std=c99", "-Wmissing-prototypes", "-Wstrict-prototypes"],
    "g++": ["-x", "c++", "-std=c++11"],
    "clang++": ["-x", "c++", "-std=c++11"],
}
ARM = {"aarch64-linux-gnu-gcc": "qemu-aarch64", "arm-linux-gnueabihf-gcc": "qemu-arm"}
"""Cross compilers, and what runs their programs."""
STEPS = 20_000
"""Steps compared between processors; a million were compared by hand."""
DRIVER = """
#include "law.h"
#include <stdio.h>
#include <stdlib.h>
int main(int argc, char **argv)
{
    REAL x[NAME_STATES], y[NAME_MEASURED], command[3];
    unsigned long long hash = 14695981039346656037ULL;
    unsigned seed = 1;
    long k, n = argc > 1 ? atol(argv[1]) : 0;
    int i;
    NAME_init(x);
    for (k = 0; k < n; k++) {
        for (i = 0; i < NAME_MEASURED; i++) {
            seed = seed * 1664525u + 1013904223u;
            y[i] = (REAL)((int)(seed >> 8) - 8388608) * ((REAL)(i < 3 ? 0.5 : 0.05) / 8388608);
            if (i < 3 && k / 500 % 4 == 3)
                y[i] = y[i] + (REAL)1;
        }
        NAME_step(x, y, command);
        for (i = 0; i < 3 * (int)sizeof command[0]; i++)
            hash = (hash ^ ((const unsigned char *)command)[i]) * 1099511628211ULL;
        for (i = 0; i < (int)sizeof x; i++)
            hash = (hash ^ ((const unsigned char *)x)[i]) * 1099511628211ULL;
    }
    printf("%016llx\\n", hash);
    return NAME_self_test();
}
"""
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


class Unit:
    """A compiled unit, called with arrays."""

    def __init__(self, law, folder, **form):
        self.type = np.float32 if form.get("single") else np.float64
        self.real = ctypes.c_float if form.get("single") else ctypes.c_double
        save_c(law, folder / "law.c", **form)
        library = folder / "law.so"
        subprocess.run([COMPILER, "-O1", "-shared", "-fPIC", folder / "law.c", "-o", library], check=True)
        self._library, self._name = ctypes.CDLL(str(library)), c_name(law.name)
        rows = re.search(r"_STATES (\d+)", (folder / "law.h").read_text())
        self.x = np.full(int(rows[1]), 7.0, dtype=self.type)

    def call(self, function, *arrays, result=ctypes.c_int):
        called = getattr(self._library, f"{self._name}_{function}")
        called.restype = result
        kept = [np.ascontiguousarray(array, dtype=self.type) for array in arrays]
        pointers = [array.ctypes.data_as(ctypes.POINTER(self.real)) for array in (self.x, *kept)]
        answer = called(*pointers)
        return answer, kept[-1] if kept else None

    def step(self, y):
        answer, command = self.call("step", y, np.zeros(3))
        return answer, command

    def number(self, function, *values, result=None):
        called = getattr(self._library, f"{self._name}_{function}")
        called.restype = self.real if result is None else result
        return called(*map(self.real, values))


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("name", ["flagship", "flagship-robust", "pid-fair", "indi"])
def test_a_start_at_any_attitude_that_is_held_commands_nothing(name, single, tmp_path):
    unit = Unit(load_law(name), tmp_path, single=single)
    euler = np.array([0.1, -0.05, 3.0])
    unit.call("start", euler, np.zeros(3))
    for _ in range(200):
        met, command = unit.step([0.0, 0.0, 0.0, *euler])
        assert met == 0
        assert np.max(np.abs(command)) < (5e-3 if single else 1e-9)


@needs_compiler
def test_a_start_takes_attitude_and_rates_of_a_law_without_reference(tmp_path):
    unit = Unit(load_law("hinf-scheduled"), tmp_path)
    unit.call("start", [0.1, 0.2, 0.3], [0.4, 0.5, 0.6])
    assert unit.x.tolist() == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.0, 0.0, 0.0]


@needs_compiler
def test_a_linear_law_starts_from_nothing(tmp_path):
    unit = Unit(load_law("hinf-d1"), tmp_path)
    unit.call("start", [0.1, 0.2, 0.3], [0.4, 0.5, 0.6])
    assert not unit.x.any()


def test_states_at_rest_are_an_equilibrium_of_the_law_itself():
    law = resample(load_law("flagship"), 400.0)
    euler = np.array([0.05, -0.02, 2.0])
    x = start = resting_states(law) @ euler
    for _ in range(100):
        x, command = step(law, x, np.array([0.0, 0.0, 0.0, *euler]))
        assert np.max(np.abs(command)) < 1e-9
    assert np.allclose(x, start, atol=1e-9)


@needs_compiler
@pytest.mark.parametrize("single", [False, True])
def test_alignment_takes_the_turn_nearest_to_the_law(single, tmp_path):
    unit = Unit(load_law("flagship"), tmp_path, single=single)
    unit.call("init")
    unit.x[:3] = 0.1, 0.0, 9.5
    unit.x[18:] = 1e-9
    unit.call("align", [0.2, -0.1, 3.2])
    assert np.allclose(unit.x[:3], [0.2, -0.1, 3.2 + 2.0 * np.pi], atol=1e-6)
    assert not single or not unit.x[18:21].any()
    assert unit.number("nearest", -3.1, 3.1) == pytest.approx(2.0 * np.pi - 3.1, abs=1e-6)


@needs_compiler
@pytest.mark.parametrize("single", [False, True])
def test_on_the_autopilots_attitude_the_law_is_aligned_at_each_step(single, tmp_path):
    (own := tmp_path / "own").mkdir()
    law, rng = load_law("flagship"), np.random.default_rng(2)
    aligned, unit = Unit(law, own, single=single), Unit(law, tmp_path, single=single, attitude=AttitudeSource.AUTOPILOT)
    aligned.call("init")
    unit.call("init")
    for _ in range(100):
        y, euler = rng.normal(0.0, 0.1, 6), rng.normal(0.0, 2.0, 3)
        expected = aligned.step(y)
        aligned.call("align", euler)
        met, command = unit.step([*y, *euler])
        assert met == expected[0]
        assert command.tobytes() == expected[1].tobytes()
        assert unit.x.tobytes() == aligned.x.tobytes()


@needs_compiler
def test_what_the_vehicle_does_not_deliver_acts_as_a_limit_of_the_law(tmp_path):
    (weak := tmp_path / "weak").mkdir()
    law = replace(load_law("pid-fair"), limits=np.full(3, 1e3))
    limited, unit = Unit(replace(law, limits=np.full(3, 2.0)), weak), Unit(law, tmp_path)
    limited.call("init")
    unit.call("init")
    seen = set()
    for y in np.random.default_rng(4).normal(0.0, 0.1, (200, 6)):
        met, delivered = limited.step(y)
        none, command = unit.step(y)
        unit.call("undelivered", delivered - command)
        assert none == 0
        assert met == sum(1 << i for i in range(3) if abs(delivered[i] - command[i]) > 1e-9)
        assert np.allclose(unit.x, limited.x, rtol=1e-12, atol=1e-15)
        seen.add(met)
    assert len(seen) == 8


@needs_compiler
@pytest.mark.parametrize("single", [False, True])
def test_a_step_in_time_is_told_from_one_that_is_late_or_early(single, tmp_path):
    unit = Unit(load_law("hinf-d1"), tmp_path, single=single)
    found = [
        unit.number("timing", seconds, result=ctypes.c_int) for seconds in (0.0, 0.0019, 0.0021, 0.0059, 0.0061, 9)
    ]
    assert found == [-1, -1, 0, 0, 1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("compiler", LANGUAGES)
@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("aided", {}),
        ("aided", {"attitude": AttitudeSource.AUTOPILOT}),
        ("flagship", {"single": True}),
        ("hinf-rates", {"single": True, "attitude": AttitudeSource.AUTOPILOT}),
        ("pid-default", {"single": True}),
    ],
)
def test_the_unit_has_no_warnings_as_c_and_cpp(name, form, compiler, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    save_c(load_law(name), tmp_path / "law.c", **form)
    command = [compiler, *LANGUAGES[compiler], *WARNINGS, f"-D{c_name(name)}_SELF_TEST", "-c", "law.c", "-o", "law.o"]
    subprocess.run(command, check=True, cwd=tmp_path)


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", [name for name in list_laws() if name != "aided"])
def test_single_precision_gives_the_bits_of_its_twin(name, tmp_path):
    assert_twins(load_law(name), tmp_path)


@needs_compiler
def test_single_precision_of_a_scheduled_law_gives_the_bits_of_its_twin(turn, tmp_path):
    assert_twins(turn(load_law("hinf-scheduled")), tmp_path)


def assert_twins(law, tmp_path):
    rng = np.random.default_rng(5)
    unit, twin = Unit(law, tmp_path, single=True), SingleLaw(law)
    unit.call("init")
    x, steep = np.zeros(len(unit.x), dtype=np.float32), 0
    for k in range(60):
        y = rng.normal(0.0, 3.0 if k % 20 == 19 else 0.1, 6)
        y[1] += 25.0 * (k >= 40)  # rad/s, over the vertical
        steep += abs(x[1]) > STEEP
        _, command = unit.step(y)
        x, expected = twin.step(x, y)
        assert command.tobytes() == expected.tobytes()
        assert unit.x.tobytes() == x.tobytes()
    assert steep or not np.any(law.G)


def test_sine_and_versine_are_as_exact_as_the_proof_says():
    u = 2.0**-24
    for x in np.concatenate([np.geomspace(1e-6, 0.75, 4000), np.linspace(0.7, 0.75, 1000)]).astype(np.float32):
        sine, versine = sin_versine(x)
        exact = float(x)
        assert abs(float(sine) - np.sin(exact)) <= 1.5 * u * np.sin(exact)
        assert abs(float(versine) - 2.0 * np.sin(0.5 * exact) ** 2) <= 2.5 * u * 2.0 * np.sin(0.5 * exact) ** 2


@pytest.mark.parametrize("angle", [-9.0, -2.5, 1.0, 2.0, 4.0, 30.0])
def test_sine_and_versine_hold_in_every_quadrant(angle):
    sine, versine = sin_versine(np.float32(angle))
    assert np.allclose([sine, versine], [np.sin(angle), 1.0 - np.cos(angle)], atol=5e-7)


def test_a_factor_in_two_floats_is_exact_to_the_bound_of_the_proof():
    for value in np.random.default_rng(6).normal(size=1000).tolist():
        coarse, fine = split(value)
        assert abs(value - coarse - fine) <= 2.0**-36 * abs(value)
        assert coarse * 2.0**40 % 2.0 ** (np.floor(np.log2(abs(coarse))) + 40 - 11) == 0.0  # of 12 bits


def test_a_float_is_written_so_that_it_is_read_again():
    values = np.random.default_rng(7).normal(size=1000).astype(np.float32) * np.float32(2.0) ** 20
    assert all(np.float32(single_number(float(value)).removesuffix("f")) == value for value in values)


@needs_compiler
def test_in_flight_single_precision_stays_as_near_as_proved(tmp_path):
    """A loop of integrators, an hour at a tilt and rates larger than those of the proof's box."""
    law = load_law("flagship")
    unit, x = Unit(law, tmp_path, single=True), np.zeros(law.order)
    unit.call("init")
    rate = np.zeros(3)
    for k in range(5000):
        gyro = rate.astype(np.float32).astype(np.float64)
        y = np.array([*gyro, 0.0, 0.0, 0.0])
        x, command = step(law, x, y)
        _, other = unit.step(y)
        assert np.max(np.abs(x[:3] - unit.x[:3])) < 1e-6
        assert np.max(np.abs(command - other)) < 2e-3
        rate += law.dt * (command / np.array([0.1, 0.12, 0.2]) + 3.0 * np.sin(np.array([0.01, 0.013, 0.007]) * k))


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("compiler", ARM)
def test_arm_gives_the_bits_of_this_processor(compiler, single, tmp_path):
    if COMPILER is None or shutil.which(compiler) is None or shutil.which(ARM[compiler]) is None:
        pytest.skip(f"no C compiler, {compiler} or {ARM[compiler]}")
    law = load_law("flagship")
    unit = save_c(law, tmp_path / "law.c", single=single)
    driver = DRIVER.replace("NAME", c_name(law.name)).replace("REAL", "float" if single else "double")
    (tmp_path / "main.c").write_text(driver)
    told = []
    for each, run in ((COMPILER, []), (compiler, [ARM[compiler]])):
        build = [
            each,
            "-O2",
            "-std=c99",
            "-static",
            f"-D{c_name(law.name)}_SELF_TEST",
            "law.c",
            "main.c",
            "-o",
            "program",
        ]
        subprocess.run(build, check=True, cwd=tmp_path)
        ran = subprocess.run([*run, "./program", str(STEPS)], check=True, cwd=tmp_path, capture_output=True, text=True)
        told.append(ran.stdout)
    assert told[0] == told[1]
    assert 0.5 * unit.operations < arm_instructions(ARM[compiler], tmp_path) <= INSTRUCTIONS * unit.operations


def arm_instructions(emulator: str, folder: Path) -> int:
    """Return the largest count of instructions of a step in the program that was built there, with all it calls."""
    traced = [emulator, "-singlestep", "-d", "exec,nochain", "-D", "trace.txt", "./program", "2"]
    subprocess.run(traced, check=True, cwd=folder, capture_output=True)
    counts, inside = [0], False
    for line in (folder / "trace.txt").read_text().splitlines():
        symbol = line.rpartition(" ")[2]
        entered = symbol.endswith("_step") and not inside
        inside = symbol not in ("main", "flagship_self_test") and (inside or entered)
        counts += [0] if entered else []
        counts[-1] += inside
    assert len(counts) > 20
    return max(counts)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "single"), [("flagship", False), ("flagship", True), ("hinf-d1", False), ("aided", False)]
)
def test_a_step_takes_no_more_instructions_than_told(name, single, tmp_path):
    if COMPILER is None or shutil.which("valgrind") is None:
        pytest.skip("no C compiler or valgrind")
    law = load_law(name)
    unit = save_c(law, tmp_path / "law.c", single=single)
    driver = DRIVER.replace("NAME", c_name(name)).replace("REAL", "float" if single else "double")
    (tmp_path / "main.c").write_text(driver)
    build = [COMPILER, "-O2", "-std=c99", f"-D{c_name(name)}_SELF_TEST", "law.c", "main.c", "-o", "program"]
    subprocess.run(build, check=True, cwd=tmp_path)
    command = [
        "valgrind",
        "--tool=callgrind",
        f"--toggle-collect={c_name(name)}_step",
        "--callgrind-out-file=/dev/null",
    ]
    ran = subprocess.run([*command, "./program", "100"], check=True, cwd=tmp_path, capture_output=True, text=True)
    tested = int(re.search(r"inputs\[(\d+)\]", unit.source)[1])
    count = int(re.search(r"Collected : (\d+)", ran.stderr)[1]) / (100 + tested)
    assert 0.5 * unit.operations < count <= INSTRUCTIONS * unit.operations


def test_operations_count_loops_calls_and_both_sides_of_a_choice():
    source = (
        "static float twice(float a)\n{\n    return a + a;\n}\n\n"
        "int f(float *x)\n{\n    for (int i = 0; i < 5; i++)\n        x[i] = twice(x[i]);\n"
        "    /* not counted: + - */\n    return x[0] < 1e-3f ? 1 : 0;\n}\n"
    )
    # 5 * (3 of the loop, assignment, call of 2 and its sum), comparison, choice
    assert count_operations(source, "f") == 5 * (3 + 1 + 2 + 1) + 2


def test_a_unit_states_cost_and_notes_in_its_header():
    unit = c_unit(load_law("hinf-d1"), notes=["Proved */ on paper."])
    assert f"at most {unit.operations} operations" in unit.header
    assert "Proved * / on paper." in unit.header


@pytest.mark.parametrize(
    ("name", "form", "words"),
    [
        ("hinf-d1", {"attitude": AttitudeSource.AUTOPILOT}, "is linear"),
        ("aided", {"single": True}, "reads the accelerometer"),
    ],
)
def test_forms_that_a_law_does_not_have_are_refused(name, form, words):
    with pytest.raises(ValueError, match=words):
        c_unit(load_law(name), **form)


def test_the_nearest_turn_is_within_half_a_turn():
    rng = np.random.default_rng(8)
    angle, to = rng.uniform(-20.0, 20.0, (2, 100))
    found = nearest(angle, to)
    assert np.max(np.abs(found - to)) <= np.pi + 1e-9
    assert np.allclose(np.exp(1j * found), np.exp(1j * angle))


def test_units_stand_in_a_folder_of_their_own(tmp_path):
    save_c(load_law("hinf-d1"), tmp_path / "mine.c")
    assert sorted(path.name for path in Path(tmp_path).iterdir()) == ["mine.c", "mine.h"]


@pytest.mark.parametrize(("name", "own"), [("flagship", 6), ("aided", 9)])
def test_step_with_the_autopilots_attitude_reads_three_numbers_more(name, own):
    law = load_law(name)
    for attitude, count in ((AttitudeSource.OWN, own), (AttitudeSource.AUTOPILOT, own + 3)):
        assert f"y[{count}]" in c_unit(law, attitude=attitude).source
