"""A law as C code: one file, one function, no library, the bits of `law_step.step`.

Each sum is written out with those of its terms whose coefficient is not 0, in the order of `law_step`. Constants are
the shortest decimals that are the law's doubles: a pole or a gain can be read, and compilers round it correctly (C99,
annex F.5).
"""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import Template
from textwrap import indent, wrap

import numpy as np
from numpy.typing import NDArray

from gustproof import __version__
from gustproof.law import Law, Output

_TEMPLATE = Path(__file__).parent / "law.c.in"
_KINEMATICS = Path(__file__).parent / "euler_rates.c"
_FORCE = ",\n * specific force x, y, z [m/s^2], (0, 0, -9.81) at rest"
_COMMANDS = {Output.TORQUE: "torque [N m]", Output.RATES: "body rates [rad/s]"}
_ESTIMATES = {0: "attitude that the law estimates [rad]", 3: "rates that it estimates [rad/s]", 6: "its other states"}
"""What the states of a scheduled law are, from which one on."""
_WIDTH = 120
_TIE = "\u00a0"
"""A space at which no line is broken."""


def c_code(law: Law) -> str:
    """Return the law as C99 source with one function `<name>_step`; its numbers are the law's to the bit.

    Compiled with `-ffp-contract=off` on a machine with IEEE doubles it gives the bits of `law_step.step`, for attitude
    estimates up to 1e5 rad.
    """
    kind = "Scheduled with the exact kinematics of its own attitude estimate." if law.scheduled else "Linear."
    made = f"{kind} Designed for vehicle '{law.provenance.vehicle}': {law.provenance.design}."
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        name=_comment(law.name), prefix=c_name(law.name), version=__version__,
        summary="\n * ".join(wrap(_comment(made), _WIDTH - 3)),
        # C has no array of no elements; a static law gets one state that is never touched.
        rows=max(law.order, 1), measured=law.D.shape[1], body=_body(law), dt=repr(law.dt),
        command=_COMMANDS[law.output], force=_FORCE if law.feels_force else "",
        kinematics=_KINEMATICS.read_text(encoding="utf-8") + "\n" if law.scheduled else "",
    )  # fmt: skip


def c_name(name: str) -> str:
    """Return a law's name as a C identifier."""
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    return identifier if re.match(r"[A-Za-z]", identifier) else f"law_{identifier}"


def _comment(text: str) -> str:
    return " ".join(text.replace("/*", "/ *").replace("*/", "* /").split())


def _body(law: Law) -> str:
    """Return what the function does; what a law does not need is neither declared nor computed."""
    n, sizes = law.order, {"x": law.order, "y": law.D.shape[1], "rates": 3, "cut": 3}
    names = [f"{array}[{i}]" for array, size in sizes.items() for i in range(size)]
    parts = [
        "/* what is asked for about each axis, and what its limit leaves of it */\ndouble u[3];",
        *_sums("u", np.hstack([law.C, law.D]), names),
        *(f"command[{i}] = limited(u[{i}], {float(limit)!r});" for i, limit in enumerate(law.limits)),
    ]
    if np.any(law.H):
        parts.append("const double cut[3] = {command[0] - u[0], command[1] - u[1], command[2] - u[2]};")
    if law.scheduled:
        parts.append("\ndouble rates[3];\neuler_rates(x, rates);")
    if n:
        parts.append(f"\ndouble next[{n}];")
        for i, line in enumerate(_sums("next", np.hstack([law.A, law.B, law.G, law.H]), names)):
            parts += [f"/* {_ESTIMATES[i]} */"] if law.scheduled and i in _ESTIMATES else []
            parts.append(line)
        parts.append(f"for (int i = 0; i < {n}; i++)\n    x[i] = next[i];")
    unread = [f"(void){array};" for array in ("x", "y") if not any(f"{array}[" in part for part in parts)]
    return indent("\n".join(unread + parts), "    ")


def _sums(target: str, matrix: NDArray[np.float64], names: Sequence[str]) -> Iterator[str]:
    """Yield one sum a row; it begins with 0.0, as the law's does, so that no sum is -0.0."""
    for i, row in enumerate(matrix.tolist()):
        terms = [_term(value, name) for value, name in zip(row, names, strict=False) if value]
        sum_ = " ".join([f"{target}[{i}]{_TIE}={_TIE}0.0", *terms]) + ";"
        yield "\n    ".join(wrap(sum_, _WIDTH - 8, break_on_hyphens=False)).replace(_TIE, " ")


def _term(value: float, name: str) -> str:
    factor = "" if abs(value) == 1.0 else f"{abs(value)!r} * "
    return f"{'-' if value < 0.0 else '+'} {factor}{name}".replace(" ", _TIE)
