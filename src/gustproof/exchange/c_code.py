"""A law as C code: one file, one function, no library, the bits of `law_step.step`."""

import re
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

from gustproof import __version__
from gustproof.law import Law, Output

_TEMPLATE = Path(__file__).parent / "law.c.in"
_FORCE = ",\n *                                          specific force x, y, z [m/s^2], (0, 0, -9.81) at rest"
_COMMANDS = {Output.TORQUE: "torque [N m]", Output.RATES: "body rates [rad/s]"}


def c_code(law: Law) -> str:
    """Return the law as C99 source with one function `<name>_step`; its numbers are the law's to the bit.

    Compiled with `-ffp-contract=off` on a machine with IEEE doubles it gives the bits of `law_step.step`, for attitude
    estimates up to 1e5 rad.
    """
    n = law.order
    # C has no array of no elements; a static law gets one state that is never touched.
    rows = max(n, 1)
    padded = {name: np.zeros((rows, getattr(law, name).shape[1])) for name in ("B", "G", "H")}
    for name, matrix in padded.items():
        matrix[:n] = getattr(law, name)
    A, C = np.zeros((rows, rows)), np.zeros((3, rows))
    A[:n, :n], C[:, :n] = law.A, law.C
    kind = "Scheduled with the exact kinematics of its own attitude estimate." if law.scheduled else "Linear."
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        name=_comment(law.name), prefix=c_name(law.name), version=__version__, summary=kind, n=n,
        rows=rows, vehicle=_comment(law.provenance.vehicle), design=_comment(law.provenance.design), dt=repr(law.dt),
        command=_COMMANDS[law.output], scheduled=int(law.scheduled), measured=law.D.shape[1],
        force=_FORCE if law.feels_force else "",
        A=_table(A), C=_table(C), D=_table(law.D), limits=_row(law.limits),
        **{name: _table(matrix) for name, matrix in padded.items()},
    )  # fmt: skip


def c_name(name: str) -> str:
    """Return a law's name as a C identifier."""
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    return identifier if re.match(r"[A-Za-z]", identifier) else f"law_{identifier}"


def _comment(text: str) -> str:
    return " ".join(text.replace("*/", "* /").split())


def _table(matrix: NDArray[np.float64]) -> str:
    return "{\n    " + ",\n    ".join(_row(row) for row in matrix) + "\n}"


def _row(row: NDArray[np.float64]) -> str:
    return "{" + ", ".join(float(value).hex() for value in row) + "}"
