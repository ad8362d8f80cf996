"""Progress in a notebook: a bar below the cell while something long runs, and nothing once it has ended.

The functions of the library take a `progress` of their own, and are silent without one. A notebook has no terminal, and
a cell that is silent for a minute looks dead: there, who gives no `progress` is shown a bar.
"""

import inspect
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import wraps
from html import escape
from types import TracebackType
from typing import Any, Self

_FIRST_S, _EACH_S = 0.5, 0.2
"""[s] before a bar appears, as what is quick needs none, and between two of its pictures."""


class NotebookBar(AbstractContextManager["NotebookBar"]):
    """A bar that is called with what any `progress` gets: a fraction, or done and all, and perhaps a text."""

    def __init__(self, title: str) -> None:
        self._title, self._handle = title, None
        self._next = time.monotonic() + _FIRST_S

    def __call__(self, *told: float | str) -> None:
        """Show how far it is; too often is left out."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + _EACH_S
        numbers = [float(each) for each in told if not isinstance(each, str)]
        share = numbers[0] / numbers[1] if len(numbers) > 1 and numbers[1] else (numbers or [0.0])[0]
        words = next((each for each in told if isinstance(each, str)), self._title)
        self._draw(f"<progress value='{min(max(share, 0.0), 1.0):.3f}'></progress> {share:.0%} {escape(words)}")

    def _draw(self, html: str) -> None:
        from IPython.display import HTML, display  # type: ignore[import-not-found]

        if self._handle is None:
            self._handle = display(HTML(html), display_id=True)
        else:
            self._handle.update(HTML(html))

    def __enter__(self) -> Self:
        """Begin; the bar appears with the first call after a while."""
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        """Take the bar away."""
        if self._handle is not None:
            self._draw("")


def with_bar(value: Any) -> Any:
    """Return a function that shows a bar if it takes a `progress` and is given none; anything else as it is."""
    if not inspect.isfunction(value) or "progress" not in inspect.signature(value).parameters:
        return value
    function: Callable[..., Any] = value

    @wraps(function)
    def shown(*given: Any, **named: Any) -> Any:
        if "progress" in named:
            return function(*given, **named)
        with NotebookBar(function.__name__.replace("_", " ")) as bar:
            return function(*given, progress=bar, **named)

    return shown
