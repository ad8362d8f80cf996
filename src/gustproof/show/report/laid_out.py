"""Figures whose parts are placed before they are drawn, once."""

from io import BytesIO
from typing import Any

from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine


class LaidOutFigure(Figure):
    """Figure in constrained layout, to be saved.

    Matplotlib draws such a figure twice to save it: first on nothing, to place its parts, then without its layout. Of
    the first time this one keeps what places them; the rest is a fifth of the time.
    """

    def __init__(self, **properties: Any) -> None:
        super().__init__(layout="constrained", **properties)

    def draw(self, renderer: RendererBase) -> None:
        """Place all parts, or draw them once the layout is off."""
        engine = self.get_layout_engine()
        if isinstance(engine, ConstrainedLayoutEngine):
            engine.execute(self)
        else:
            super().draw(renderer)

    def _repr_png_(self) -> bytes:
        """Return the picture that a notebook shows."""
        with BytesIO() as file:
            self.savefig(file, format="png", dpi=80)
            return file.getvalue()
