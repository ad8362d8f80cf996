import shutil
import subprocess
from ctypes import CDLL, POINTER, c_double
from dataclasses import replace

import numpy as np
import pytest

from gustproof.exchange.c_code import c_code, c_name
from gustproof.law import Law, load_law, shipped_laws
from gustproof.law_step import step

COMPILER = shutil.which("cc") or shutil.which("gcc")
FLAGS = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC"]
STEPS = 100_000


def compiled_step(law: Law, tmp_path):
    source, library = tmp_path / "law.c", tmp_path / "law.so"
    source.write_text(c_code(law))
    subprocess.run(
        [COMPILER, *FLAGS, str(source), "-o", str(library)],
        check=True,
    )  # fmt: skip
    function = getattr(CDLL(str(library)), f"{c_name(law.name)}_step")
    function.argtypes, function.restype = [POINTER(c_double)] * 3, None
    return function


def pointer(array):
    return array.ctypes.data_as(POINTER(c_double))


def assert_same_bits(law: Law, inputs, tmp_path) -> None:
    function = compiled_step(law, tmp_path)
    x, mine, command = np.zeros(law.order), np.zeros(max(law.order, 1)), np.empty(3)
    cut = 0
    for y in inputs:
        x, expected = step(law, x, y)
        function(pointer(mine), pointer(y), pointer(command))
        assert command.tobytes() == expected.tobytes()
        assert mine[: law.order].tobytes() == x.tobytes()
        cut += np.count_nonzero(np.abs(command) == law.limits)
    assert np.all(np.isfinite(x))
    assert 0 < cut < 3 * len(inputs)  # both sides of the limit were seen


@pytest.mark.compiled
@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_compiled_c_gives_the_bits_of_the_law_over_a_hundred_thousand_steps(tmp_path):
    law = load_law("aided")  # every part of the form: exact kinematics, specific force
    rng = np.random.default_rng(5)
    inputs = np.hstack([rng.normal(0.0, sigma, (STEPS, 3)) for sigma in (0.3, 0.1, 1.0)])
    assert_same_bits(law, inputs, tmp_path)


@pytest.mark.compiled
@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize("name", shipped_laws())
def test_every_shipped_law_gives_its_bits_in_c(name, tmp_path):
    law = load_law(name)
    rng = np.random.default_rng(6)
    inputs = np.hstack([rng.normal(0.0, sigma, (2000, 3)) for sigma in (0.3, 0.1, 1.0)])
    # limits low enough to be met
    assert_same_bits(replace(law, limits=np.full(3, 0.5)), inputs, tmp_path)


@pytest.mark.compiled
@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_a_law_without_states_is_c_too(tmp_path):
    static = replace(
        load_law("hinf-d1"), name="3 gains, no state",
        A=np.zeros((0, 0)), B=np.zeros((0, 6)), C=np.zeros((3, 0)), D=np.eye(3, 6),
        G=np.zeros((0, 3)), H=np.zeros((0, 3)), limits=np.full(3, 0.5),
    )  # fmt: skip
    assert c_name(static.name) == "law_3_gains__no_state"
    assert_same_bits(static, np.random.default_rng(7).normal(0.0, 0.5, (100, 6)), tmp_path)


def test_a_design_can_not_end_the_comment_it_stands_in():
    law = load_law("hinf-d1")
    hostile = replace(law, provenance=replace(law.provenance, design="a */ int b; /*\nc"))
    header = c_code(hostile).split("#define")[0]
    assert header.count("*/") == 1
