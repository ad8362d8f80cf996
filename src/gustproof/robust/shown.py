"""Results that show themselves: a few lines in a terminal, a table in a notebook."""

import re
from collections.abc import Callable
from html import escape

from gustproof.checker.directed_rounding import print_down, print_up

_MOST = 10
"""Most lines that a result prints."""
_DIGITS = 4
"""Digits of a figure that is shown; a claim's JSON has all of them."""
_ASSUMED = re.compile(r"(moment within |slopes below |gyro noise of )([\d.e+-]+(?:, [\d.e+-]+)*)")
_BOUND = re.compile(r"(gain .* is below )([\d.e+-]+)")


def shorten_statement(statement: str) -> str:
    """Return a proved claim with short figures, and torques in N m: bounds are rounded up, what it assumes down.

    So the shown claim follows from the proved one.
    """
    words = _ASSUMED.sub(lambda found: found[1] + _round(found[2], print_down), statement)
    words = _BOUND.sub(lambda found: found[1] + _round(found[2], print_up), words)
    return words.replace("N*m", "N m")


def _round(figures: str, rounded: Callable[[float, int], str]) -> str:
    return ", ".join(rounded(float(figure), _DIGITS) for figure in figures.split(", "))


class Shown:
    """Something that says in a few lines what it is; `lines` is what differs."""

    __slots__ = ()

    def lines(self) -> list[str]:
        """Return what it is: a title, then a line for each part, `name: value`."""
        raise NotImplementedError

    def __str__(self) -> str:
        lines = self.lines()
        left = len(lines) - _MOST
        return "\n".join([*lines[: _MOST - 1], f"... and {left + 1} more"] if left > 0 else lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        title, *rest = self.lines()
        cells = [line.partition(": ")[::2] for line in rest]
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in cells)
        return f"<table><caption>{escape(title)}</caption>{rows}</table>"
