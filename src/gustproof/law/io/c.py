"""A law as C code: a source and its header, no library, the bits of `gustproof.law.step.step`.

Each sum is written out with its nonzero terms, in the order of `gustproof.law.step`. Constants are the shortest
decimals of the law's doubles: poles and gains stay legible, and compilers round them correctly (C99, annex F.5).
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from string import Template
from textwrap import indent, wrap

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import write_text
from gustproof.law.form import GYRO_REFERENCE_SIZE, Law, Output
from gustproof.law.step import MEASURED_SIZE, step
from gustproof.version import __version__

_FOLDER = Path(__file__).parent
_FORCE = ";\n *          specific force x, y, z [m/s^2], (0, 0, -9.81) at rest"
_COMMANDS = {Output.TORQUE: "torque [N m]", Output.RATES: "body rates [rad/s]"}
_ESTIMATES = {0: "estimated attitude [rad]", 3: "estimated rates [rad/s]", 6: "other states"}
"""Meaning of the states of a scheduled law, by the first of each group."""
_STATES = ("PHI", "THETA", "PSI", "P", "Q", "R")
"""Names of the first states of a scheduled law."""
_START = ": level, yaw 0, at rest. For another attitude, write it to the first three afterwards"
_GROWING, _SHRINKING = np.geomspace(0.01, 100.0, 16), np.geomspace(10.0, 0.01, 8)
"""Sizes of the inputs of the self-test, one a step: until limits are met, and while a limited rate turns back."""
_WIDTH = 120
_NBSP = "\u00a0"
"""Space without a line break."""


def save_c(law: Law, path: Path) -> None:
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
    write_text(path, c_code(law, header.name))
    write_text(header, c_header(law))


def c_code(law: Law, header: str = "law.h") -> str:
    """Return the law as C99 source with `<name>_init` and `<name>_step`; its numbers are the law's to the bit.

    With IEEE doubles it gives the bits of `gustproof.law.step.step`, for attitude estimates up to 1e5 rad. With
    `<name>_SELF_TEST` defined `<name>_self_test` compares them over some steps, the last of them at the limits.
    """
    kind = "Scheduled with the exact kinematics of its own attitude estimate." if law.is_scheduled else "Linear."
    if law.rate_limit is not None:
        kind += f" The rates commanded from attitude are within {_numbers(law.rate_limit.limits)} rad/s."
    made = f"{kind} Designed for vehicle '{law.provenance.vehicle}': {law.provenance.design}."
    used = {"euler_rates": law.is_scheduled, "rate_excess": law.rate_limit is not None, "tilt": law.uses_accelerometer}
    files = [name for name, needed in {"sin_cos": any(used.values()), **used}.items() if needed]
    functions = "".join((_FOLDER / f"{name}.c").read_text(encoding="utf-8") + "\n" for name in files)
    return _filled(
        "law.c.in", law, header=header, summary="\n * ".join(wrap(_comment(made), _WIDTH - 3)), functions=functions,
        body=_body(law), **_self_test(law),
    )  # fmt: skip


def c_header(law: Law) -> str:
    """Return the header of `c_code`: prototypes, sizes and sample time, names of states, units and signs."""
    prefix, states = c_name(law.name), ""
    if law.is_scheduled:
        names = [f"    {prefix}_{name} = {i}," for i, name in enumerate(_STATES)]
        for i, what in sorted(_ESTIMATES.items(), reverse=True)[1:]:
            names.insert(i, f"    /* {what} */")
        states = "\n/* Offsets of the named states in x. */\nenum {\n" + "\n".join(names)[:-1] + "\n};\n"
    return _filled(
        "law.h.in", law, dt=repr(law.dt), command=_COMMANDS[law.output], force=_FORCE if law.uses_accelerometer else "",
        states=states, start=_START if law.is_scheduled else "",
    )  # fmt: skip


def _filled(template: str, law: Law, **parts: str) -> str:
    # C has no empty arrays; a static law gets one unused state.
    return Template((_FOLDER / template).read_text(encoding="utf-8")).substitute(
        name=_comment(law.name), prefix=c_name(law.name), version=__version__, rows=str(max(law.order, 1)),
        measured=str(_inputs(law)), **parts,
    )  # fmt: skip


def _self_test(law: Law) -> dict[str, str]:
    """Return inputs that grow from 0, with commands and last state while these are finite."""
    sizes = _GROWING if law.rate_limit is None else np.concatenate([_GROWING, _SHRINKING])
    inputs = np.round(sizes[:, None] * np.random.default_rng(1).normal(size=(len(sizes), _inputs(law))), 3)
    inputs[0] = 0.0
    x, last, commands = np.zeros(law.order), np.zeros(max(law.order, 1)), []
    for y in inputs:
        with np.errstate(all="ignore"):
            x, command = step(law, x, y)
        if not (np.all(np.isfinite(x)) and np.all(np.isfinite(command))):
            break
        last[: law.order] = x
        commands.append(command.tolist())
    return {
        "steps": str(len(commands)),
        "inputs": _rows(map(repr, row) for row in inputs[: len(commands)].tolist()),
        "commands": _rows(map(float.hex, row) for row in commands),
        "last": _listed(map(float.hex, last.tolist()), 8),
    }


def _inputs(law: Law) -> int:
    """Return how many numbers the step reads: gyro and reference, and specific force if the law uses it."""
    return MEASURED_SIZE if law.uses_accelerometer else GYRO_REFERENCE_SIZE


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


def _body(law: Law) -> str:
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
