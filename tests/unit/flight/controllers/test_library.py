import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.flight.controllers.library import LibraryStepper, load_library
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.law.form import Output, load_law
from gustproof.law.step import step
from gustproof.law.write.c import save_c
from gustproof.law.write.single import SingleLaw

pytestmark = [
    pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc"),
]

FACTS = (
    "const struct {{ int numbers[5]; double dt, limits[3]; const char *name; }} mine_facts = {{ {{{numbers}}}, {dt} }};"
)
STEP = """
void mine_init(double *x) { x[0] = 2.0; }
int mine_step(double *x, double *y, double *u) { u[0] = x[0]++; return 0; }
"""


@pytest.fixture
def build(tmp_path):
    """Return what compiles a text of C, or the file of a law, as a library; it returns the entry."""

    def compile_(source: str | Path, name: str = "law"):
        if isinstance(source, str):
            (tmp_path / f"{name}.c").write_text(source)
            source = tmp_path / f"{name}.c"
        out = tmp_path / f"{name}.so"
        subprocess.run(["gcc", "-O1", "-shared", "-fPIC", source, "-o", out], check=True)
        return parse_controller(str(out))

    return compile_


@pytest.mark.parametrize(("name", "single"), [("flagship", False), ("hinf-rates", False), ("hinf-scheduled", True)])
def test_an_exported_law_tells_its_facts_and_steps_as_the_law(build, tmp_path, name, single):
    law = load_law(name)
    save_c(law, tmp_path / "law.c", single=single)
    library = load_library(build(tmp_path / "law.c"))
    assert (library.name, library.dt, library.output) == (law.name, law.dt, law.output)
    assert (library.is_single, library.uses_accelerometer) == (single, law.uses_accelerometer)
    flown, x = LibraryStepper(library), np.zeros(library.order)
    own = SingleLaw(law) if single else None
    for gyro in np.random.default_rng(1).normal(size=(5, 3)).round(3):
        y = np.concatenate([gyro, np.zeros(3)])
        x, command = own.step(x, y) if own else step(law, x[: law.order], y)
        assert np.array_equal(flown.step(gyro, np.zeros(3), np.zeros(3), law.dt), command)


def test_a_library_by_hand_begins_where_its_init_says(build):
    text = FACTS.format(numbers="1, 6, 8, 0, 0", dt=0.004) + STEP
    flown = LibraryStepper(load_library(build(text)))
    zeros = np.zeros(3)
    assert [flown.step(zeros, zeros, zeros, 0.004)[0] for _ in range(2)] == [2.0, 3.0]
    flown.reset()
    assert flown.step(zeros, zeros, zeros, 0.004)[0] == 2.0
    assert load_library(build(text, "again")).output is Output.TORQUE


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("int nothing;", "has no <name>_facts"),
        (FACTS.format(numbers="1, 6, 8, 0, 0", dt=0.004), "has no mine_init"),
        (FACTS.format(numbers="1, 7, 8, 0, 0", dt=0.004) + STEP, "measured 7"),
        *(
            (FACTS.format(numbers=numbers, dt=0.004) + STEP, complaint)
            for numbers, complaint in (
                ("0, 6, 8, 0, 0", "states 0"),
                ("4097, 6, 8, 0, 0", "states 4097"),
                ("1, 6, 5, 0, 0", "bytes 5"),
                ("1, 6, 8, 2, 0", "rates 2"),
                ("1, 6, 8, 0, 4097", "reserved 4097"),
                ("1, 6, 8, 0, -1", "reserved -1"),
            )
        ),
        *(
            (FACTS.format(numbers="4096, 9, 8, 1, 4096", dt=dt) + STEP, f"dt {told}")
            for dt, told in (("-0.004", "-0.004"), ("0.0", "0.0"), ("1.0 / 0.0", "inf"))
        ),
        (FACTS.format(numbers="1, 6, 8, 0, 0", dt=0.004) + STEP + "int other_facts;", "facts of mine, other"),
    ],
)
def test_a_library_without_one_laws_facts_is_bad_input(build, text, complaint):
    with pytest.raises(ConfigError, match=complaint):
        load_library(build(text))


def test_a_file_that_is_no_library_is_bad_input(tmp_path):
    (tmp_path / "law.so").write_text("no ELF")
    with pytest.raises(ConfigError, match=r"law\.so': .*(invalid ELF|too short)"):
        load_library(parse_controller(f"{tmp_path}/law.so"))
