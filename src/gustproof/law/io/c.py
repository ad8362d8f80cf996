"""A law as C code: a source and its header, no library, the bits of `gustproof.law.step.step`.

Each sum is written out with its nonzero terms, in the order of `gustproof.law.step`. Constants are the shortest
decimals of the law's doubles: poles and gains stay legible, and compilers round them correctly (C99, annex F.5).
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from enum import Enum
from pathlib import Path
from string import Template
from textwrap import indent, wrap
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import write_text
from gustproof.law.form import GYRO_REFERENCE_SIZE, Law, Output
from gustproof.law.step import MEASURED_SIZE, step
from gustproof.version import __version__

_FOLDER = Path(__file__).parent
_COMMANDS = {Output.TORQUE: "torque [N m]", Output.RATES: "body rates [rad/s]"}
_ESTIMATES = {0: "estimated attitude [rad]", 3: "estimated rates [rad/s]", 6: "other states"}
"""Meaning of the states of a scheduled law, by the first of each group."""
_STATES = ("PHI", "THETA", "PSI", "P", "Q", "R")
"""Names of the first states of a scheduled law."""
_LINEAR = " The law is linear:\n * no state is named, all become 0, and attitude counts from here."
_NO_WINDUP = " This law\n * cannot wind up: it needs no word of it."
_ALIGN = """
/* Replace the attitude of the law by another estimate of it [rad], of the time of the last step's gyro sample. */
void ${prefix}_align($real x[$rows], const $real euler[3])"""
_ALIGN_BODY = """
{
    for (int i = 0; i < 3; i++)
        x[i] = ${prefix}_nearest(euler[i], x[i]);
}
"""
_DOUBLE_GUARD = """/* Fails to compile if the build makes constants floats and its compiler has no pragma against it. */
typedef char ${prefix}_constants_are_double[sizeof(1.0) == sizeof(double) ? 1 : -1];
"""
_DOUBLE = {
    "real": "double", "whole": "long long", "zero": "0.0", "half": "0.5", "one": "1.0",
    "turns": "0.15915494309189535", "turn": "6.283185307179586", "guard": _DOUBLE_GUARD,
}  # fmt: skip
"""Words and numbers of C in double precision."""
_GROWING, _SHRINKING = np.geomspace(0.01, 100.0, 16), np.geomspace(10.0, 0.01, 8)
"""Sizes of the inputs of the self-test, one a step: until limits are met, and while a limited rate turns back."""
_WIDTH = 120
_NBSP = "\u00a0"
"""Space without a line break."""


class Attitude(Enum):
    """Source of the attitude of an exported law."""

    OWN = "own"
    """The law integrates its gyro."""
    AUTOPILOT = "autopilot"
    """An estimate is given at each step, in place of the law's own attitude after it."""


class CUnit(NamedTuple):
    """Texts of a unit in C."""

    source: str
    """Text of the `.c` file, which includes the header by its name."""
    header: str
    """Text of the `.h` file."""


def save_c(law: Law, path: Path, attitude: Attitude = Attitude.OWN) -> None:
    """Write the law as C source, and its header beside it.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import load_law, save_c
    >>> with TemporaryDirectory() as folder:
    ...     save_c(load_law("pid-fair"), Path(folder) / "law.c")
    ...     sorted(file.name for file in Path(folder).iterdir())
    ['law.c', 'law.h']
    """
    header = path.with_suffix(".h")
    unit = c_unit(law, header.name, attitude)
    write_text(path, unit.source)
    write_text(header, unit.header)


def c_unit(law: Law, header: str = "law.h", attitude: Attitude = Attitude.OWN) -> CUnit:
    """Return the law as C99 and C++ that needs no library; its numbers are the law's to the bit.

    With IEEE doubles `<name>_step` gives the bits of `gustproof.law.step.step`, for attitude estimates up to 1e5 rad.
    With `<name>_SELF_TEST` defined `<name>_self_test` compares them over some steps, the last of them at the limits.
    The header tells how to start, align and reset it.

    Raises
    ------
    ValueError
        If the autopilot's attitude is asked for and the law is linear: none of its states is known as attitude.
    """
    if attitude is Attitude.AUTOPILOT and not law.is_scheduled:
        raise ValueError(f"law '{law.name}' is linear: none of its states is known as attitude, so it keeps its own")
    words = {
        **_DOUBLE, "name": _comment(law.name), "prefix": c_name(law.name), "version": __version__,
        "rows": str(max(law.order, 1)),  # C has no empty arrays; a static law gets one unused state
        "measured": str(_inputs(law, attitude)), "dt": repr(law.dt), "rate": repr(round(1.0 / law.dt, 9)),
        "early": repr(0.5 * law.dt), "late": repr(1.5 * law.dt), "header": header, "command": _COMMANDS[law.output],
    }  # fmt: skip
    return CUnit(_source(law, attitude, words), _header(law, attitude, words))


def _source(law: Law, attitude: Attitude, words: dict[str, str]) -> str:
    kind = "Scheduled with the exact kinematics of its own attitude estimate." if law.is_scheduled else "Linear."
    if attitude is Attitude.AUTOPILOT:
        kind += " After each step its attitude becomes the autopilot's."
    if law.rate_limit is not None:
        kind += f" The rates commanded from attitude are within {_numbers(law.rate_limit.limits)} rad/s."
    made = f"{kind} Designed for vehicle '{law.provenance.vehicle}': {law.provenance.design}."
    made += " The arithmetic equals the flown law's to the bit."
    used = {"euler_rates": law.is_scheduled, "rate_excess": law.rate_limit is not None, "tilt": law.uses_accelerometer}
    files = [name for name, needed in {"sin_cos": any(used.values()), **used}.items() if needed]
    start = ["for (int i = 0; i < 3; i++) {", "    x[i] = euler[i];", "    x[3 + i] = gyro[i];", "}"]
    return _filled("law.c.in", {
        "summary": "\n * ".join(wrap(_comment(made), _WIDTH - 3)),
        "functions": "".join(_filled(f"{name}.c", words) + "\n" for name in files),
        "start": indent("\n".join(start if law.is_scheduled else ["(void)euler;", "(void)gyro;"]), "    "),
        "body": _body(law, attitude, words),
        "windup": indent("\n".join(_windup(law)), "    "),
        "align": Template(_ALIGN.split("*/")[1] + _ALIGN_BODY).substitute(words) if law.is_scheduled else "",
        **words, "guard": Template(words["guard"]).substitute(words), **_self_test(law, attitude),
    })  # fmt: skip


def _header(law: Law, attitude: Attitude, words: dict[str, str]) -> str:
    prefix, states = words["prefix"], ""
    if law.is_scheduled:
        names = [f"    {prefix}_{name} = {i}," for i, name in enumerate(_STATES)]
        for i, what in sorted(_ESTIMATES.items(), reverse=True)[1:]:
            names.insert(i, f"    /* {what} */")
        states = "\n/* Offsets of the named states in x. */\nenum {\n" + "\n".join(names)[:-1] + "\n};\n"
    inputs = ["gyro p, q, r [rad/s]", "reference phi, theta, psi [rad]"]
    if law.uses_accelerometer:
        inputs.append("specific force x, y, z [m/s^2], (0, 0, -9.81) at rest")
    if attitude is Attitude.AUTOPILOT:
        inputs.append("attitude phi, theta, psi [rad] by the autopilot, of the gyro's time")
    return _filled("law.h.in", {
        **words,
        "inputs": ";\n *          ".join(inputs),
        "states": states,
        "notes": "",
        "start": "" if law.is_scheduled else _LINEAR,
        "windup": "" if np.any(law.H) else _NO_WINDUP,
        "align": Template(_ALIGN + ";\n").substitute(words) if law.is_scheduled else "",
    })  # fmt: skip


def _filled(template: str, words: dict[str, str]) -> str:
    return Template((_FOLDER / template).read_text(encoding="utf-8")).substitute(words)


def _self_test(law: Law, attitude: Attitude) -> dict[str, str]:
    """Return inputs that grow from 0, with commands and last state while these are finite."""
    sizes = _GROWING if law.rate_limit is None else np.concatenate([_GROWING, _SHRINKING])
    inputs = np.round(sizes[:, None] * np.random.default_rng(1).normal(size=(len(sizes), _inputs(law, attitude))), 3)
    inputs[0] = 0.0
    x, last, commands = np.zeros(law.order), np.zeros(max(law.order, 1)), []
    for y in inputs:
        with np.errstate(all="ignore"):
            x, command = step(law, x, y[: _inputs(law)])
        if not (np.all(np.isfinite(x)) and np.all(np.isfinite(command))):
            break
        if attitude is Attitude.AUTOPILOT:
            align(x, y[-3:])
        last[: law.order] = x
        commands.append(command.tolist())
    return {
        "steps": str(len(commands)),
        "samples": _rows(map(repr, row) for row in inputs[: len(commands)].tolist()),
        "commands": _rows(map(repr, row) for row in commands),
        "last": _listed(map(repr, last.tolist()), 8),
    }


def align(x: NDArray[np.float64], euler: NDArray[np.float64]) -> None:
    """Replace the attitude [rad] in the state by another estimate, of the turn nearest to it, as `<name>_align`."""
    x[:3] = euler + np.floor((x[:3] - euler) * 0.15915494309189535 + 0.5) * 6.283185307179586


def _inputs(law: Law, attitude: Attitude = Attitude.OWN) -> int:
    """Return how many numbers the step reads."""
    own = MEASURED_SIZE if law.uses_accelerometer else GYRO_REFERENCE_SIZE
    return own + 3 * (attitude is Attitude.AUTOPILOT)


def _numbers(values: NDArray[np.float64]) -> str:
    return ", ".join(map(repr, values.tolist()))


def _rows(rows: Iterable[Iterable[str]]) -> str:
    return "\n".join("        {" + ", ".join(row) + "}," for row in rows)


def _listed(numbers: Iterable[str], margin: int) -> str:
    return indent("\n".join(wrap(", ".join(numbers), _WIDTH - margin, break_on_hyphens=False)), margin * " ")


def c_name(name: str) -> str:
    """Return a law's name as a C identifier."""
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    return identifier if re.match(r"[A-Za-z]", identifier) else f"law_{identifier}"


def _comment(text: str) -> str:
    return " ".join(text.replace("/*", "/ *").replace("*/", "* /").split())


def _windup(law: Law) -> Iterator[str]:
    """Yield the sums that the excess of a command adds to the states."""
    if not np.any(law.H):
        yield from ("(void)x;", "(void)missing;")
    for i, row in enumerate(law.H.tolist()):
        yield from (f"x[{i}] += {value!r} * missing[{j}];" for j, value in enumerate(row) if value)


def _body(law: Law, attitude: Attitude, words: dict[str, str]) -> str:
    """Return the body of the step; parts that a law does not need are neither declared nor computed."""
    n = law.order
    sizes = {"x": n, "y": GYRO_REFERENCE_SIZE, "tilt": 2 * law.uses_accelerometer, "rates": 3, "excess": 3, "over": 3}
    names = [f"{array}[{i}]" for array, size in sizes.items() for i in range(size)]
    none, limit = np.zeros((3, 6)), law.rate_limit
    parts = ["/* roll and pitch by gravity */\ndouble tilt[2];\ntilt_of(y + 6, x, tilt);\n"] * law.uses_accelerometer
    if limit is not None:
        parts += [
            "/* rates commanded from attitude, and what is over their limits */",
            f"static const double rate_limits[3] = {{{_numbers(limit.limits)}}};",
            f"static const double attitude_limits[3] = {{{_numbers(law.attitude_limits)}}};",
            "double s[3], over[3];",
            *_sums("s", np.hstack([limit.S, limit.T]), names),
            "rate_excess(x, s, rate_limits, attitude_limits, over);\n",
        ]
    U, V = (np.zeros((3, 0)), np.zeros((n, 0))) if limit is None else (limit.U, limit.V)
    parts += [
        "/* command about each axis, before and within its limit */\ndouble u[3];",
        *_sums("u", np.hstack([law.C, law.D, none, U]), names),
        *(f"command[{i}] = limited(u[{i}], {bound!r});" for i, bound in enumerate(law.limits.tolist())),
    ]
    if np.any(law.H):
        parts.append("const double excess[3] = {command[0] - u[0], command[1] - u[1], command[2] - u[2]};")
    if law.is_scheduled:
        parts.append("\ndouble rates[3];\neuler_rates(x, rates);")
    if n:
        parts.append(f"\ndouble next[{n}];")
        for i, line in enumerate(_sums("next", np.hstack([law.A, law.B, law.G, law.H, V]), names)):
            parts += [f"/* {_ESTIMATES[i]} */"] if law.is_scheduled and i in _ESTIMATES else []
            parts.append(line)
        parts.append(f"for (int i = 0; i < {n}; i++)\n    x[i] = next[i];")
    if attitude is Attitude.AUTOPILOT:
        parts.append(f"{words['prefix']}_align(x, y + {_inputs(law)});")
    parts.append("\nint met = 0;\nfor (int i = 0; i < 3; i++)\n    met |= (command[i] < u[i] || command[i] > u[i]) << i;")
    parts.append("return met;")
    unread = [f"(void){array};" for array in ("x", "y") if not any(f"{array}[" in part for part in parts)]
    return indent("\n".join(unread + parts), "    ")


def _sums(target: str, matrix: NDArray[np.float64], names: Sequence[str]) -> Iterator[str]:
    """Yield one sum a row; it begins with 0.0, as in `gustproof.law.step`, so that no sum is -0.0."""
    for i, row in enumerate(matrix.tolist()):
        terms = [_term(value, name) for value, name in zip(row, names, strict=False) if value]
        sum_ = " ".join([f"{target}[{i}]{_NBSP}={_NBSP}0.0", *terms]) + ";"
        yield "\n    ".join(wrap(sum_, _WIDTH - 8, break_on_hyphens=False)).replace(_NBSP, " ")


def _term(value: float, name: str) -> str:
    factor = "" if abs(value) == 1.0 else f"{abs(value)!r} * "
    return f"{'-' if value < 0.0 else '+'} {factor}{name}".replace(" ", _NBSP)
