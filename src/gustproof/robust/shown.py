"""Results that show themselves: a few lines in a terminal, a table in a notebook."""

from html import escape

_MOST = 10
"""Most lines that a result prints."""


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
