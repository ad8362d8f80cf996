import re
import shutil
import subprocess
from ctypes import CDLL, c_void_p
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from gustproof.law.form import Law, RateLimit, Schedule, list_laws, load_law
from gustproof.law.step import STEEP, step
from gustproof.law.write.c import AttitudeSource, c_name, c_unit, save_c

COMPILER = shutil.which("cc") or shutil.which("gcc")
FLAGS = ["-std=c99", "-O2", "-ffp-contract=off", "-fPIC"]
WARNINGS = ["-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Wfloat-equal",
            "-Wmissing-prototypes", "-Wstrict-prototypes", "-Werror"]  # fmt: skip
CPU = Path("/proc/cpuinfo")
FUSED = ["-mfma"] if CPU.exists() and " fma " in CPU.read_text() else []
"""Flag of a processor that multiplies and adds in one."""
BUILDS = {
    "gcc": (), "clang": (),
    "gcc -fsingle-precision-constant": ("-fsingle-precision-constant",),
    # clang says that it does not have the flag
    "clang -fsingle-precision-constant": ("-fsingle-precision-constant", "-Wno-ignored-optimization-argument"),
    "gcc -ffast-math": (*FUSED, "-O3", "-ffast-math", "-fsingle-precision-constant", "-ffp-contract=fast"),
    "clang -ffp-contract=on": (*FUSED, "-O3", "-ffp-contract=on"),
}  # fmt: skip
"""Flags of builds that must give the bits."""
STEPS = 100_000
COUPLED = 12


def coupled_law() -> Law:
    """Return a law in which all axes, the kinematics and the limits meet in every sum, but for a few coefficients."""
    rng = np.random.default_rng(8)
    shapes = {"A": (COUPLED, COUPLED), "B": (COUPLED, 8), "C": (3, COUPLED), "D": (3, 8), "G": (COUPLED, 3),
              "H": (COUPLED, 3), "S": (3, COUPLED), "T": (3, 8), "U": (3, 3), "V": (COUPLED, 3)}  # fmt: skip
    parts = {name: rng.uniform(-0.05, 0.05, shape) for name, shape in shapes.items()}
    np.fill_diagonal(parts["S"], 2.0)
    limit = RateLimit(**{name: parts.pop(name) for name in "STUV"}, limits=np.array([0.03, 0.05, 0.07]))
    parts["A"][2, 3:9], parts["B"][7], parts["C"][1, ::2] = 0.0, 0.0, 0.0
    parts["A"][4, 4], parts["D"][2, 2], parts["C"][2, 5], parts["B"][0, 0] = 1.0 / 3.0, -1.0, 1.0, 1e-300
    # at x = 0, y = -0.0 each product of the first command is -0.0, the command is not
    parts["C"][0], parts["D"][0] = -np.abs(parts["C"][0]), np.abs(parts["D"][0])
    names = ("phi", "theta", "p", "q", "r", "phi")
    sizes = {"J": (6, COUPLED), "K": (6, 8), "L": (6, 6), "P": (3, 6), "Q": (COUPLED, 6)}
    turn = Schedule(
        parameters=names,
        limits=np.array([0.3, 0.1, 0.5, 1.0, 0.7, 3.0]),
        **{name: rng.uniform(-0.2, 0.2, shape) for name, shape in sizes.items()},
    )
    both = {"rate_limit": limit, "schedule": turn}
    return replace(load_law("aided"), name="coupled", limits=np.array([0.05, 0.3, 0.4]), **both, **parts)


def compiled(law: Law, tmp_path, *flags: str, compiler: str | None = COMPILER) -> Path:
    source, part, library = tmp_path / "law.c", tmp_path / "law.o", tmp_path / "law.so"
    save_c(law, source)
    # Linked without the flags: a library linked with -ffast-math would switch this process to flush small numbers to 0.
    for command in (
        [compiler, *FLAGS, *WARNINGS, *flags, "-c", str(source), "-o", str(part)],
        [compiler, "-shared", str(part), "-o", str(library)],
    ):
        subprocess.run(command, check=True, capture_output=True, text=True)
    return library


def compiled_step(law: Law, tmp_path):
    library = compiled(law, tmp_path)
    function = getattr(CDLL(str(library)), f"{c_name(law.name)}_step")
    function.argtypes = [c_void_p] * 3
    return function


def slow_rates(rng: np.random.Generator) -> np.ndarray:
    """Return rates that change every 100 steps, so that the attitude is often beyond its limit."""
    return np.repeat(rng.normal(0.0, 1.0, (STEPS // 100, 3)), 100, axis=0) + rng.normal(0.0, 0.1, (STEPS, 3))


def assert_same_bits(law: Law, inputs, tmp_path) -> None:
    function, inputs = compiled_step(law, tmp_path), np.ascontiguousarray(inputs)
    count, x, mine = len(inputs), np.zeros(law.order), np.zeros(max(law.order, 1))
    states, own = np.zeros((count + 1, law.order)), np.zeros((count, law.order))
    expected, commands = np.empty((count, 3)), np.empty((count, 3))
    for k, y in enumerate(inputs):
        x, expected[k] = step(law, x, y)
        states[k + 1] = x
        function(mine.ctypes.data, inputs.ctypes.data + k * inputs.strides[0], commands.ctypes.data + 24 * k)
        own[k] = mine[: law.order]
    assert commands.tobytes() == expected.tobytes()
    assert own.tobytes() == states[1:].tobytes()
    assert np.all(np.isfinite(x))
    # both sides of the limit were seen
    assert 0 < np.count_nonzero(np.abs(commands) == law.limits) < 3 * count
    if law.rate_limit is not None:
        fast = np.any(np.abs(states[:-1, :2]) > law.attitude_limits[:2], axis=1)
        assert 0 < np.count_nonzero(fast) < count
    if np.any(law.G):
        assert 0 < np.count_nonzero(np.abs(states[:-1, 1]) > STEEP) < count


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_compiled_c_gives_the_bits_of_the_law_over_a_hundred_thousand_steps(tmp_path):
    law = load_law("aided")  # every part of the form: exact kinematics, specific force, limit of the rate
    rng = np.random.default_rng(5)
    inputs = np.hstack([slow_rates(rng), *(rng.normal(0.0, sigma, (STEPS, 3)) for sigma in (0.1, 1.0))])
    assert_same_bits(law, inputs, tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_c_of_the_default_law_gives_its_bits_while_its_rate_is_limited(tmp_path):
    law, rng = load_law("flagship"), np.random.default_rng(10)
    assert_same_bits(law, np.hstack([slow_rates(rng), rng.normal(0.0, 0.1, (STEPS, 3))]), tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize("name", list_laws())
def test_every_shipped_law_gives_its_bits_in_c(name, tmp_path):
    law = load_law(name)
    rng = np.random.default_rng(6)
    inputs = np.hstack([rng.normal(0.0, sigma, (2000, 3)) for sigma in (4.0, 0.1, 1.0)])
    # limits low enough to be met
    limit = law.rate_limit and replace(law.rate_limit, limits=np.full(3, 0.2))
    assert_same_bits(replace(law, limits=np.full(3, 0.5), rate_limit=limit), inputs, tmp_path)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_a_law_whose_axes_couple_gives_its_bits_in_c(tmp_path):
    inputs = np.random.default_rng(9).normal(0.0, 1.0, (2000, 9))
    inputs[::50] *= 10.0  # a steep pitch
    inputs[0] = -0.0
    assert_same_bits(coupled_law(), inputs, tmp_path)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_a_law_without_states_is_c_too(tmp_path):
    static = replace(
        load_law("hinf-d1"), name="3 gains, no state",
        A=np.zeros((0, 0)), B=np.zeros((0, 6)), C=np.zeros((3, 0)), D=np.eye(3, 6),
        G=np.zeros((0, 3)), H=np.zeros((0, 3)), limits=np.full(3, 0.5),
    )  # fmt: skip
    assert c_name(static.name) == "law_3_gains__no_state"
    assert_same_bits(static, np.random.default_rng(7).normal(0.0, 0.5, (100, 6)), tmp_path)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_a_law_that_reads_nothing_is_c_without_warnings(tmp_path):
    law = load_law("hinf-d1")
    compiled(replace(law, B=np.zeros((9, 6)), D=np.zeros((3, 6))), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("build", BUILDS)
@pytest.mark.parametrize("name", list_laws())
def test_self_test_finds_the_bits_of_every_shipped_law_in_strict_builds(build, name, tmp_path):
    if (compiler := shutil.which(build.split()[0])) is None:
        pytest.skip(f"no {build.split()[0]}")
    law = load_law(name)
    library = compiled(law, tmp_path, f"-D{c_name(name)}_SELF_TEST", *BUILDS[build], compiler=compiler)
    assert getattr(CDLL(str(library)), f"{c_name(name)}_self_test")() == 0


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize("place", [0, -1])
def test_self_test_finds_a_coefficient_that_is_off(place, tmp_path, monkeypatch):
    law = load_law("hinf-scheduled")
    unit = c_unit(law)
    code = unit.source
    terms = list(re.finditer(r"(\d\S*) \* (?:x|rates)\[\d+\]", code[: code.index("_self_test")]))
    term = [each for each in terms if each.start() > code.index("_step(")][place]
    off = float(term[1]) * (1.0 + 1e-12)
    monkeypatch.setattr(
        "gustproof.law.write.c.c_unit",
        lambda *_args, **_form: unit._replace(source=code[: term.start(1)] + repr(off) + code[term.end(1) :]),
    )
    library = compiled(law, tmp_path, "-Dhinf_scheduled_SELF_TEST")
    assert 0 < CDLL(str(library)).hinf_scheduled_self_test() <= 24


@pytest.mark.skipif(not (FUSED and shutil.which("clang")), reason="no clang, or nothing to fuse")
def test_self_test_finds_a_build_that_fuses(tmp_path):
    library = compiled(load_law("aided"), tmp_path, "-Daided_SELF_TEST", *FUSED, "-ffp-contract=fast", compiler="clang")
    assert CDLL(str(library)).aided_self_test() > 0


@pytest.mark.skipif(shutil.which("clang") is None, reason="no clang")
def test_c_whose_constants_would_be_floats_is_refused(tmp_path):
    with pytest.raises(subprocess.CalledProcessError) as refused:
        compiled(load_law("hinf-d1"), tmp_path, "-cl-single-precision-constant", compiler="clang")
    assert "constants_are_double" in refused.value.stderr


@pytest.mark.parametrize("name", list_laws())
def test_only_what_a_law_computes_is_written(name):
    law, code = load_law(name), c_unit(load_law(name)).source
    function = code[code.index("_step(double") :]
    terms = re.findall(r"[+-] [^;+-]*?(?:e-\d+[^;+-]*?)?\b(?:x|y|tilt|rates|excess|over)\[\d+\]", function)
    parts = [law.A, law.B, law.C, law.D, law.G, law.H]
    if (limit := law.rate_limit) is not None:
        parts += [limit.S, limit.T, limit.U, limit.V]
    assert len(terms) == sum(np.count_nonzero(part) for part in parts)
    assert ("sin_cos" in code) == law.is_scheduled
    assert ("arctan2" in code) == ("turn_steep" in code) == np.any(law.G)
    assert ("rate_excess" in code) == (limit is not None)
    assert ("excess[" in function) == np.any(law.H)
    assert max(map(len, code.splitlines())) <= 120


def test_a_design_can_not_end_or_nest_the_comment_it_stands_in():
    law = load_law("hinf-d1")
    hostile = replace(law, provenance=replace(law.provenance, design="a */ int b; /*/ /*\nc"))
    header = c_unit(hostile).source.split("#if")[0]
    assert header.count("*/") == 1
    assert header.count("/*") == 1
    header = c_unit(hostile).header.split("#ifndef")[0]
    assert header.count("*/") == 1
    assert header.count("/*") == 1


def test_header_says_what_the_named_states_are():
    states = c_unit(load_law("flagship")).header.split("enum {\n")[1].split("\n};")[0].split(",\n")
    phi, *angles, p, q, r = (line.strip().removesuffix(",") for line in states)
    assert phi == "/* estimated attitude [rad] */\n    flagship_PHI = 0"
    assert p == "/* estimated rates [rad/s] */\n    flagship_P = 3"
    assert [*angles, q, r] == [f"flagship_{name}" for name in ("THETA = 1", "PSI = 2", "Q = 4", "R = 5")]


@pytest.mark.parametrize("name", ["flagship", "aided"])
@pytest.mark.parametrize("attitude", AttitudeSource)
def test_header_says_what_is_measured_in_its_order(name, attitude):
    said = c_unit(load_law(name), attitude=attitude).header.split(" * y        ")[1].split("\n * command")[0]
    measured = [line.split(" [")[0] for line in said.split(";\n *          ")]
    expected = ["gyro p, q, r", "reference phi, theta, psi"]
    expected += ["specific force x, y, z"] * (name == "aided")
    assert measured == expected + ["attitude phi, theta, psi"] * (attitude is AttitudeSource.AUTOPILOT)


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_header_serves_a_program_in_cpp_that_starts_at_an_attitude(tmp_path):
    law = load_law("aided")
    library = compiled(law, tmp_path)
    (tmp_path / "main.cpp").write_text(
        '#include "law.h"\n#include <cstdio>\n'
        "int main()\n{\n"
        "    double x[aided_STATES], y[aided_MEASURED] = {0}, command[3];\n"
        "    for (double &state : x)\n        state = 1e9;\n"
        "    aided_init(x);\n"
        "    x[aided_PSI] = 0.25;\n"
        "    aided_step(x, y, command);\n"
        '    std::printf("%a %a %a %a", command[0], command[1], command[2], aided_DT);\n}\n'
    )
    program = str(tmp_path / "main")
    strict = ["-std=c++98", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    subprocess.run(["g++", "-x", "c++", *strict, "-fsyntax-only", str(tmp_path / "law.h")], check=True)
    subprocess.run(["g++", *strict[1:], str(tmp_path / "main.cpp"), str(library), "-o", program], check=True)
    told = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    _, command = step(law, np.eye(law.order)[2] * 0.25, np.zeros(9))
    assert [float.fromhex(number) for number in told] == [*command, law.dt]


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_a_sample_that_is_not_finite_changes_nothing_and_is_told(real: type, tmp_path: Path) -> None:
    save_c(load_law("flagship"), tmp_path / "law.c", single=real is np.float32)
    part, library = tmp_path / "law.o", tmp_path / "law.so"
    fast = ["-O3", "-ffast-math"] if COMPILER and "gcc" in Path(COMPILER).resolve().name else []
    for command in (["-c", str(tmp_path / "law.c"), *FLAGS, *WARNINGS, *fast, "-o", str(part)],
                    ["-shared", str(part), "-o", str(library)]):  # fmt: skip
        subprocess.run([COMPILER, *command], check=True)
    functions = CDLL(str(library))

    def call(name: str, *arrays: np.ndarray) -> int:
        return int(getattr(functions, f"flagship_{name}")(*(c_void_p(each.ctypes.data) for each in arrays)))

    x, u, good = np.zeros(64, real), np.zeros(3, real), np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], real)
    call("step", x, good, u)
    kept, held = x.copy(), u.copy()
    for bad, place in product((np.nan, np.inf, -np.inf, 1e20), range(6)):
        y = good.copy()
        y[place] = bad
        assert call("step", x, y, u) == 1
        call("undelivered", x, y[3:] if place > 2 else y[:3].copy())
        call("start", x, *((good[:3], y[3:].copy()) if place > 2 else (y[:3].copy(), good[:3])))
        np.testing.assert_array_equal(x, kept)
        np.testing.assert_array_equal(u, held)
    assert call("step", x, good, u) == 0
    assert np.isfinite(u).all()
