"""A law as C code: a source and its header, no library, the bits of `gustproof.law.step.step`.

Each sum is written out with its nonzero terms, in the order of `gustproof.law.step`. Constants are the shortest
decimals of the law's doubles: poles and gains stay legible, and compilers round them correctly (C99, annex F.5).
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import Enum
from pathlib import Path
from string import Template
from textwrap import indent, wrap
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.whole_file import write_files
from firmware_model.exact import multiply
from gustproof.law.form import ANGLES, BODY_RATES, GYRO_REFERENCE_SIZE, Law, Output, Schedule
from gustproof.law.step import MEASURED_SIZE, STEEP, schedule_factor, step
from gustproof.law.write.operations import INSTRUCTIONS, count_operations
from gustproof.law.write.single import SingleLaw, single_number, split
from gustproof.version import __version__

_FOLDER = Path(__file__).parent
_COMMANDS = {Output.TORQUE: "torque [N m]", Output.RATES: "body rates [rad/s]"}
_ESTIMATES = {0: "estimated attitude [rad]", 3: "estimated rates [rad/s]", 6: "other states"}
"""Meaning of the states of a scheduled law, by the first of each group."""
_STATES = ("PHI", "THETA", "PSI", "P", "Q", "R")
"""Names of the first states of a scheduled law."""
_STARTS = {
    (True, True): "\n * The law holds this attitude if it is the reference.",
    (True, False): "\n * It takes no reference: it turns to level and yaw 0.",
    (False, True): "\n * The law is linear: no state is named, all become 0, and attitude counts from here.",
    (False, False): "\n * The law is linear: no state is named, all become 0, and attitude counts from here.",
}
"""Words about the start of a law that is scheduled, and takes references."""
_NO_WINDUP = " This law\n * cannot wind up: the call is optional."
_ALIGN = """
/* Replace the attitude of the law by another estimate of it [rad], of the time of the last step's gyro sample. */
void ${prefix}_align($real x[$rows], const $real euler[3])"""
_ALIGN_BODY = """
{
    for (int i = 0; i < 3; i++)
        x[i] = ${prefix}_nearest(euler[i], x[i]);
$exact}
"""
_DOUBLE = {
    "real": "double",
    "whole": "long long",
    "zero": "0.0",
    "half": "0.5",
    "one": "1.0",
    "two": "2.0",
    "steep": repr(STEEP),
    "euler_rate": "rates[n]",
    "turns": "0.15915494309189535",
    "turn": "6.283185307179586",
    "most": "1e9",
    "guard": (
        "/* Fails to compile if the build makes constants floats and its compiler has no pragma against it. */\n"
        "typedef char ${prefix}_constants_are_double[sizeof(1.0) == sizeof(double) ? 1 : -1];\n"
    ),
}
"""Words and numbers of C in double precision."""
_SINGLE = {
    "real": "float",
    "whole": "int",
    "zero": "0.0f",
    "half": "0.5f",
    "one": "1.0f",
    "two": "2.0f",
    "steep": single_number(STEEP),
    "euler_rate": "(x[3 + n] + rates[n])",
    "turns": "0.15915494f",
    "turn": "6.2831855f",
    "most": "1e9f",
    "guard": (
        "/* Fails to compile if a float is not IEEE single precision. */\n"
        "typedef char ${prefix}_floats_are_single[sizeof(float) == 4 && FLT_MANT_DIG == 24 ? 1 : -1];\n"
    ),
}
"""The same in single precision."""
_GROWING, _SHRINKING = np.geomspace(0.01, 400.0, 16), np.geomspace(10.0, 0.01, 8)
"""Sizes of the inputs of the self-test, one a step: until limits and a steep pitch are met; then rates turn back."""
_WIDTH = 120
_NBSP = "\u00a0"
"""Space without a line break."""


class AttitudeSource(Enum):
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
    operations: int
    """Bound of the operations of a step; `gustproof.law.write.operations` tells what counts."""


def save_c(
    law: Law,
    path: Path,
    attitude: AttitudeSource = AttitudeSource.OWN,
    *,
    single: bool = False,
    notes: Sequence[str] = (),
) -> CUnit:
    """Write the law as C source, and its header beside it; return the texts, see `c_unit`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import load_law, save_c
    >>> with TemporaryDirectory() as folder:
    ...     unit = save_c(load_law("pid-fair"), Path(folder) / "law.c")
    ...     sorted(file.name for file in Path(folder).iterdir())
    ['law.c', 'law.h']
    """
    header = path.with_suffix(".h")
    unit = c_unit(law, header.name, attitude, single=single, notes=notes, library=attitude is AttitudeSource.OWN)
    write_files({path: unit.source, header: unit.header})
    return unit


def c_unit(
    law: Law,
    header: str = "law.h",
    attitude: AttitudeSource = AttitudeSource.OWN,
    *,
    single: bool = False,
    notes: Sequence[str] = (),
    library: bool = False,
) -> CUnit:
    """Return the law as C99 and C++ that needs no library; its numbers are the law's to the bit.

    With IEEE doubles `<name>_step` gives the bits of `gustproof.law.step.step`, for attitude estimates up to 1e5 rad.
    With `single` it computes in IEEE single precision, to the bits of `gustproof.law.write.single.SingleLaw`.
    With `<name>_SELF_TEST` defined `<name>_self_test` compares them over some steps, the last of them at the limits.
    The header tells how to start, align and reset it; `notes` are paragraphs of its comment. As a `library` it tells
    its facts, for `gustproof.flight.controllers.library`.

    Raises
    ------
    ValueError
        If the autopilot's attitude is asked for and the law is linear: none of its states is known as attitude. If
        single precision is asked for and the law reads the accelerometer.
    """
    if attitude is AttitudeSource.AUTOPILOT and not law.is_scheduled:
        raise ValueError(f"law '{law.name}' is linear: none of its states is known as attitude, so it keeps its own")
    writer = _Writer(law, attitude, SingleLaw(law) if single else None, library)
    words = {**writer.words(), "header": header}
    source = _source(writer, words)
    operations = count_operations(source, f"{words['prefix']}_step")
    cost = (
        f"A step takes at most {operations} operations on every path, and below {INSTRUCTIONS * operations} machine "
        "instructions where the processor has them: GCC at -O2, x86-64 and ARM."
    )
    remarks = "".join(f"\n *\n * {_in_comment(note)}" for note in (cost, *notes))
    return CUnit(source, _header(writer, {**words, "notes": remarks}), operations)


def c_name(name: str) -> str:
    """Return a law's name as a C identifier."""
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    return identifier if re.match(r"[A-Za-z]", identifier) else f"law_{identifier}"


def _source(writer: "_Writer", words: dict[str, str]) -> str:
    law = writer.law
    kind = _kind(law)
    if writer.attitude is AttitudeSource.AUTOPILOT:
        kind += " After each step its attitude becomes the autopilot's."
    if law.rate_limit is not None:
        kind += f" The rates commanded from attitude are within {_numbers(law.rate_limit.limits.tolist(), repr)} rad/s."
    made = f"{kind} Designed for vehicle '{law.provenance.vehicle}': {law.provenance.design}."
    made += (
        " The arithmetic equals the flown law's to the bit."
        if writer.single is None
        else " In single precision; sums of slow states carry a second float."
    )
    functions = "".join(_fill(f"{name}.c", words) + "\n" for name, needed in _functions(writer).items() if needed)
    return _fill(
        "law.c.in",
        {
            **words,
            **_self_test(writer),
            "guard": Template(words["guard"]).substitute(words),
            "include": "" if writer.single is None else "#include <float.h>\n",
            "summary": _in_comment(made),
            "functions": functions,
            "library": writer.library("c", words),
            "start": writer.start(),
            "body": writer.body(),
            "windup": writer.windup(),
            "align": _align(writer, words, _ALIGN.split("*/")[1] + _ALIGN_BODY),
        },
    )


def _functions(writer: "_Writer") -> dict[str, bool]:
    """Return which functions the step calls, in the order of their definition."""
    law, single = writer.law, writer.single
    is_exact, is_limited = law.has_kinematics, law.rate_limit is not None
    turns = law.is_scheduled or is_limited or law.uses_accelerometer
    if single is None:
        feels = is_exact or law.uses_accelerometer
        first = {"absolute": feels, "sin_cos": turns, "arctan2": feels, "euler_rates": is_exact}
    else:
        turned = is_exact or is_limited or law.schedule is not None
        first = {"wide_sum": bool(single.wide), "sin_versine": turns, "euler_excess": is_exact}
        first |= {"sin_cos_single": turned, "arctan2_single": is_exact}
    more = {"half_tangent": writer.reads_angles, "turn_steep": is_exact}
    return {**first, **more, "rate_excess": is_limited, "tilt": law.uses_accelerometer}


def _kind(law: Law) -> str:
    if law.schedule is not None:
        return f"Scheduled on {', '.join(dict.fromkeys(law.schedule.parameters))}: its estimate, its gyro."
    return "Scheduled with the exact kinematics of its own attitude estimate." if law.has_kinematics else "Linear."


def _header(writer: "_Writer", words: dict[str, str]) -> str:
    law, prefix, states = writer.law, words["prefix"], ""
    if law.is_scheduled:
        names = [f"    {prefix}_{name} = {i}," for i, name in enumerate(_STATES)]
        for i, what in sorted(_ESTIMATES.items(), reverse=True)[1:]:
            names.insert(i, f"    /* {what} */")
        states = "\n/* Offsets of the named states in x. */\nenum {\n" + "\n".join(names)[:-1] + "\n};\n"
    inputs = ["gyro p, q, r [rad/s]", "reference phi, theta, psi [rad]"]
    if law.uses_accelerometer:
        inputs.append("specific force x, y, z [m/s^2], (0, 0, -9.81) at rest")
    if writer.attitude is AttitudeSource.AUTOPILOT:
        inputs.append("attitude phi, theta, psi [rad] by the autopilot, of the gyro's time")
    return _fill(
        "law.h.in",
        {
            **words,
            "inputs": ";\n *          ".join(inputs),
            "states": states,
            "start": _STARTS[law.is_scheduled, law.takes_references],
            "windup": "" if np.any(law.H) else _NO_WINDUP,
            "align": _align(writer, words, _ALIGN + ";\n"),
            "library": writer.library("h", words),
            "bits": "flown law's" if writer.single is None else "single-precision law's",
        },
    )


def _align(writer: "_Writer", words: dict[str, str], template: str) -> str:
    if not writer.law.is_scheduled:
        return ""
    low = (
        "" if writer.single is None else f"    for (int i = 0; i < 3; i++)\n        x[{writer.law.order} + i] = 0.0f;\n"
    )
    return Template(template).substitute(words, exact=low)


def _fill(template: str, words: dict[str, str]) -> str:
    return Template((_FOLDER / template).read_text(encoding="utf-8")).substitute(words)


def _self_test(writer: "_Writer") -> dict[str, str]:
    """Return inputs that grow from 0, with commands and last state while these are finite."""
    law, single = writer.law, writer.single
    sizes = _GROWING if law.rate_limit is None and not law.has_kinematics else np.concatenate([_GROWING, _SHRINKING])
    inputs = np.round(sizes[:, None] * np.random.default_rng(1).normal(size=(len(sizes), writer.measured)), 3)
    inputs[0] = 0.0
    x, last, commands = np.zeros(writer.rows), np.zeros(writer.rows), []
    for y in inputs:
        with np.errstate(all="ignore"):
            if single is None:
                x, command = step(law, x[: law.order], y[: inputs_of(law)])
            else:
                x, command = single.step(x, y)
        if not (np.all(np.isfinite(x)) and np.all(np.isfinite(command))):
            break
        if writer.attitude is AttitudeSource.AUTOPILOT:
            x[:3] = nearest(y[-3:], x[:3]) if single is None else single.nearest(y[-3:], x[:3])
            x[law.order : law.order + 3] = 0.0  # the low parts of the attitude
        last[: len(x)] = x
        commands.append(command.tolist())
    return {
        "steps": str(len(commands)),
        "samples": _rows(map(writer.number, row) for row in inputs[: len(commands)].tolist()),
        "commands": _rows(map(writer.number, row) for row in commands),
        "last": _list(map(writer.number, last.tolist()), 8),
    }


def nearest(angle: NDArray[np.float64], to: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles [rad] whole turns from `angle` that are nearest to `to`, as `<name>_nearest`."""
    return np.asarray(angle + np.floor((to - angle) * 0.15915494309189535 + 0.5) * 6.283185307179586)


def inputs_of(law: Law) -> int:
    """Return how many numbers a law reads on its own attitude."""
    return MEASURED_SIZE if law.uses_accelerometer else GYRO_REFERENCE_SIZE


def resting_states(law: Law) -> NDArray[np.float64]:
    """Return the states (n, 3) of a law that holds a unit attitude, its reference, at rest and without command.

    If attitude leaks, it has no such equilibrium: then the others are at theirs. Without reference they are 0. A linear
    law has no state that is known as attitude: all are 0.
    """
    n, limit = law.order, law.rate_limit
    states = np.eye(n, 3) if law.is_scheduled else np.zeros((n, 3))
    if not (law.is_scheduled and law.takes_references):
        return states
    own = np.hstack([law.A + law.G @ np.eye(3, n, 3) - np.eye(n), law.B[:, 3:6]])[3:]
    sums = [np.hstack([law.C, law.D[:, 3:6]]), *([] if limit is None else [np.hstack([limit.S, limit.T[:, 3:6]])])]
    for whole in (np.vstack([own, *sums]), own):
        others, rest = whole[:, 3:n], np.zeros((n - 3, 3))
        for _ in range(3):  # exact residuals leave nothing of LAPACK's rounding, which differs between machines
            residual = multiply(np.hstack([whole[:, :3] + whole[:, n:], others]), np.vstack([np.eye(3), rest]))
            rest = rest - np.linalg.lstsq(others, residual, rcond=1e-10)[0]
        if np.max(np.abs(residual)) <= 1e-9 * np.max(np.abs(whole[:, :3])):
            break
    states[3:] = np.where(np.abs(rest) > 1e-9 * (1.0 + np.max(np.abs(rest))), rest, 0.0)
    return states


class _Writer(NamedTuple):
    """A law and the form of its C."""

    law: Law
    attitude: AttitudeSource
    single: SingleLaw | None
    """The law in single precision; `None` in double."""
    is_library: bool
    """True with facts for a program that loads it."""

    @property
    def measured(self) -> int:
        """Count of numbers that the step reads."""
        return inputs_of(self.law) + 3 * (self.attitude is AttitudeSource.AUTOPILOT)

    @property
    def reads_angles(self) -> bool:
        """True if an estimated angle is a parameter of its schedule."""
        schedule = self.law.schedule
        return schedule is not None and not set(ANGLES).isdisjoint(schedule.parameters)

    @property
    def rows(self) -> int:
        """Count of states; C has no empty arrays, so a static law gets one unused state."""
        return max(self.law.order + (0 if self.single is None else len(self.single.wide)), 1)

    def words(self) -> dict[str, str]:
        """Return what stands for the placeholders that all C templates share, by name."""
        law = self.law
        return {
            **(_DOUBLE if self.single is None else _SINGLE),
            "name": _comment(law.name),
            "prefix": c_name(law.name),
            "version": __version__,
            "rows": str(self.rows),
            "measured": str(self.measured),
            "dt": self.number(law.dt),
            "rate": self.number(round(1.0 / law.dt, 9)),
            "early": self.number(0.5 * law.dt),
            "late": self.number(1.5 * law.dt),
            "command": _COMMANDS[law.output],
        }

    def number(self, value: float) -> str:
        """Return the shortest decimal of a number."""
        return repr(value) if self.single is None else single_number(value)

    def start(self) -> str:
        """Return the assignments of `<name>_start`; a scheduled law knows its rates too."""
        if not self.law.is_scheduled:
            return "    (void)euler;\n    (void)gyro;"
        lines, wide = [f"x[{i}] = euler[{i}];" for i in range(3)], []
        slow = () if self.single is None else self.single.wide
        for i, row in enumerate(resting_states(self.law).tolist()[3:], 3):
            factors = {f"euler[{j}]": value for j, value in enumerate(row) if value}
            if i in slow:
                wide += ["sum[0] = sum[1] = 0.0f;", *(_product(v, name, self.number) for name, v in factors.items())]
                wide.append(f"settle(sum, &x[{i}], &x[{self.law.order + slow.index(i)}]);")
            elif factors or i < 6:
                lines.append(f"x[{i}] = {self._resting_sum(i, factors)};")
        return indent("\n".join([*lines, "float sum[2];", *wide] if wide else lines), "    ")

    def _resting_sum(self, i: int, factors: dict[str, float]) -> str:
        """Return the sum of state i at rest; the three after the attitude begin with the gyro."""
        first = [f"gyro[{i - 3}]"] if i < 6 else []
        terms = " ".join([*first, *(_term(v, name, self.number) for name, v in factors.items())])
        return terms.removeprefix(f"+{_NBSP}").replace(_NBSP, " ")

    def windup(self) -> str:
        """Return the sums that the excess of a command adds to the states."""
        lines = ["(void)x;", "(void)missing;"] if not np.any(self.law.H) else []
        for i, row in enumerate(self.law.H.tolist()):
            lines += [f"x[{i}] += {self.number(value)} * missing[{j}];" for j, value in enumerate(row) if value]
        return indent("\n".join(lines), "    ")

    def body(self) -> str:
        """Return the body of the step."""
        lines = [*self._step(), *["turn_steep(x, rates, next);"] * self.law.has_kinematics]
        whole = "\n".join([*lines, "y[" * (self.attitude is AttitudeSource.AUTOPILOT), "x[" * (self.law.order > 0)])
        lines = [f"(void){array};" for array in ("x", "y") if f"{array}[" not in whole] + lines
        if self.law.order:
            lines.append(f"for (int i = 0; i < {self.rows}; i++)\n    x[i] = next[i];")
        if self.attitude is AttitudeSource.AUTOPILOT:
            lines.append(f"{c_name(self.law.name)}_align(x, y + {inputs_of(self.law)});")
        lines.append("\nint met = 0;\nfor (int i = 0; i < 3; i++)")
        lines.append("    met |= (command[i] < u[i] || command[i] > u[i]) << i;\nreturn met;")
        return indent("\n".join(lines), "    ")

    def _step(self) -> list[str]:
        """Return the sums of the step; parts that a law does not need are neither declared nor computed."""
        law, n, real = self.law, self.law.order, "double" if self.single is None else "float"
        names = self._names()
        none, limit = np.zeros((3, 6)), law.rate_limit
        parts = [
            "/* roll and pitch by gravity */\ndouble tilt[2];\ntilt_of(y + 6, x, tilt);\n"
        ] * law.uses_accelerometer
        P, Q = none[:, :0], np.zeros((n, 0))
        if law.schedule is not None:
            parts += self._schedule(law.schedule, names)
            P, Q = law.schedule.P, law.schedule.Q
        if limit is not None:
            parts += [
                "/* rates commanded from attitude, and what is over their limits */",
                f"static const {real} rate_limits[3] = {{{_numbers(limit.limits.tolist(), self.number)}}};",
                f"static const {real} attitude_limits[3] = {{{_numbers(law.attitude_limits.tolist(), self.number)}}};",
                f"{real} s[3], over[3];",
                *self._sums("s", np.hstack([limit.S, limit.T]), names),
                "rate_excess(x, s, rate_limits, attitude_limits, over);\n",
            ]
        U, V = (none[:, :3], np.zeros((n, 3))) if limit is None else (limit.U, limit.V)
        parts += [
            f"/* command about each axis, before and within its limit */\n{real} u[3];",
            *self._sums("u", np.hstack([law.C, law.D, none, U, P]), names),
            *(f"command[{i}] = limited(u[{i}], {self.number(bound)});" for i, bound in enumerate(law.limits.tolist())),
        ]
        if np.any(law.H):
            parts.append(f"const {real} excess[3] = {{command[0] - u[0], command[1] - u[1], command[2] - u[2]}};")
        if law.has_kinematics:
            parts.append(f"\n{real} rates[3];\n{'euler_rates' if self.single is None else 'euler_excess'}(x, rates);")
        if n:
            A = law.A if self.single is None else self.single.A
            parts += self._next(np.hstack([A, law.B, law.G, law.H, V, Q]), names)
        return parts

    def _schedule(self, schedule: Schedule, names: list[str]) -> Iterator[str]:
        """Yield the outputs of a schedule: its equation, eliminated without pivots as in `gustproof.law.step`."""
        k, real, number = len(schedule.parameters), "double" if self.single is None else "float", self.number
        yield "/* each parameter as a share of its limit, and the inputs of the schedule */"
        yield f"{real} share[{k}], turned[{k}];"
        sources = dict(zip((*ANGLES, *BODY_RATES), ("x[0]", "x[1]", "y[0]", "y[1]", "y[2]"), strict=True))
        for i, (name, limit) in enumerate(zip(schedule.parameters, schedule.limits.tolist(), strict=True)):
            function, factor = "half_tangent" if name in ANGLES else "limited", schedule_factor(name, limit)
            yield f"share[{i}] = {function}({sources[name]}, {number(limit)}) * {number(factor)};"
        yield from self._sums("turned", np.hstack([schedule.J, schedule.K]), names)
        yield f"/* its outputs, by elimination */\n{real} rest[{k}][{k}]{', factor' * (k > 1)};"
        for i, row in enumerate(schedule.L.tolist()):
            yield f"turned[{i}] = share[{i}] * turned[{i}];"
            for j, value in enumerate(row):
                sign, one = "-" if value >= 0.0 else "+", number(float(i == j))
                yield f"rest[{i}][{j}] = {one} {sign} share[{i}] * {number(abs(value))};"
        yield from self._elimination(k)
        yield ""

    @staticmethod
    def _elimination(k: int) -> Iterator[str]:
        for c in range(k):
            for i in range(c + 1, k):
                yield f"factor = rest[{i}][{c}] / rest[{c}][{c}];"
                yield from (f"rest[{i}][{j}] -= factor * rest[{c}][{j}];" for j in range(c + 1, k))
                yield f"turned[{i}] -= factor * turned[{c}];"
        for i in range(k - 1, -1, -1):
            yield from (f"turned[{i}] -= rest[{i}][{j}] * turned[{j}];" for j in range(i + 1, k))
            yield f"turned[{i}] /= rest[{i}][{i}];"

    def library(self, suffix: str, words: dict[str, str]) -> str:
        """Return the facts of a library; empty for other C."""
        if not self.is_library:
            return ""
        limits = _numbers(self.law.limits.tolist(), self.number)
        rates = str(int(self.law.output is Output.RATES))
        facts = {"limits": limits, "rates": rates, "label": json.dumps(self.law.name)}
        return _fill(f"library.{suffix}.in", words | facts)

    def _names(self) -> list[str]:
        law = self.law
        sizes = {
            "x": law.order,
            "y": GYRO_REFERENCE_SIZE,
            "tilt": 2 * law.uses_accelerometer,
            "rates": 3,
            "excess": 3,
            "over": 3,
            "turned": 0 if law.schedule is None else len(law.schedule.parameters),
        }
        return [f"{array}[{i}]" for array, size in sizes.items() for i in range(size)]

    def _next(self, matrix: NDArray[np.float64], names: list[str]) -> Iterator[str]:
        """Yield the sums of the next states."""
        n, real = self.law.order, "double" if self.single is None else "float"
        wide = () if self.single is None else self.single.wide
        yield f"\n{real} next[{self.rows}];" + ("\nfloat sum[2];" if wide else "")
        for i, line in enumerate(self._sums("next", matrix, names)):
            if self.law.is_scheduled and i in _ESTIMATES:
                yield f"/* {_ESTIMATES[i]} */"
            if self.single is None or i not in wide:
                yield line
            else:
                yield from self._wide_sum(i, n + wide.index(i), matrix[i], names)

    def _wide_sum(self, i: int, low: int, row: NDArray[np.float64], names: list[str]) -> Iterator[str]:
        """Yield the sum of a state that is held in two floats, `x[i]` and `x[low]`."""
        own = float(row[i])
        yield f"sum[0] = {f'x[{i}]' if own == 1.0 else '0.0f'};"
        yield f"sum[1] = {'' if own == 1.0 else self.number(own) + ' * '}x[{low}];"
        for j, (value, name) in enumerate(zip(row.tolist(), names, strict=False)):
            if not value or (j == i and own == 1.0):
                continue
            if abs(value) == 1.0 or name.startswith(("rates", "excess", "over", "turned")):
                yield f"add(sum, {_term(value, name, self.number).removeprefix('+' + _NBSP).replace(_NBSP, ' ')});"
            else:
                yield _product(value, name, self.number)
        yield f"settle(sum, &next[{i}], &next[{low}]);"

    def _sums(self, target: str, matrix: NDArray[np.float64], names: Sequence[str]) -> Iterator[str]:
        """Yield one sum a row; it begins with 0.0, as in `gustproof.law.step`, so that no sum is -0.0."""
        for i, row in enumerate(matrix.tolist()):
            terms = [_term(value, name, self.number) for value, name in zip(row, names, strict=False) if value]
            sum_ = " ".join([f"{target}[{i}]{_NBSP}={_NBSP}{self.number(0.0)}", *terms]) + ";"
            yield "\n    ".join(wrap(sum_, _WIDTH - 8, break_on_hyphens=False)).replace(_NBSP, " ")


def _product(value: float, name: str, number: Callable[[float], str]) -> str:
    coarse, fine = split(value)
    return f"add_product(sum, {number(coarse)}, {number(fine)}, {name});"


def _term(value: float, name: str, number: Callable[[float], str]) -> str:
    factor = "" if abs(value) == 1.0 else f"{number(abs(value))} * "
    return f"{'-' if value < 0.0 else '+'} {factor}{name}".replace(" ", _NBSP)


def _numbers(values: Iterable[float], number: Callable[[float], str]) -> str:
    return ", ".join(map(number, values))


def _rows(rows: Iterable[Iterable[str]]) -> str:
    return "\n".join("        {" + ", ".join(row) + "}," for row in rows)


def _list(numbers: Iterable[str], margin: int) -> str:
    return indent("\n".join(wrap(", ".join(numbers), _WIDTH - margin, break_on_hyphens=False)), margin * " ")


def _comment(text: str) -> str:
    return " ".join(text.replace("/*", "/ *").replace("*/", "* /").split())


def _in_comment(text: str) -> str:
    return "\n * ".join(wrap(_comment(text), _WIDTH - 3))
