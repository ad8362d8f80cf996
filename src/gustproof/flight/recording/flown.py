"""Results that show themselves in a notebook, draw themselves and become tables; the records of a flight are one."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from firmware_model.numerics.rotations import euler_angles
from firmware_model.types import AXES
from gustproof.robust.shown import Shown
from gustproof.types import Array, Records

if TYPE_CHECKING:
    import pyarrow
    from matplotlib.figure import Figure

_PARTS = {
    "q_NB": ("w", "x", "y", "z"),
    "position_N": ("north", "east", "down"),
    "velocity_N": ("north", "east", "down"),
    "wind_N": ("north", "east", "down"),
}
"""Names of the components of a field that are not those of the body's axes."""


class Drawn(Shown):
    """A result that draws itself too."""

    __slots__ = ()

    def plot(self, *others: Any, **options: Any) -> "Figure":
        """Return a figure, with `others` of its kind in the same axes; a notebook shows it, `savefig` writes it.

        Of a flight `kind` is "euler-angles", "body-rates" or "torques".
        """
        draw = import_module("gustproof.show.report.drawn").draw  # what draws stands above what flies
        figure: Figure = draw(self, *others, **options)
        return figure


class Tabled(Drawn):
    """A result that is a table too."""

    __slots__ = ()

    def to_arrow(self) -> "pyarrow.Table":
        """Return the table, units by the columns' names."""
        raise NotImplementedError

    def to_pandas(self) -> Any:
        """Return the table as a DataFrame of pandas, which must be installed."""
        return self.to_arrow().to_pandas()


class FlownRecords(Tabled, np.ndarray[Any, np.dtype[np.void]]):
    """Journal records (n,) of a flight, an array of `firmware_model.recording.journal` that shows itself.

    Examples
    --------
    >>> from gustproof import fly_direct, load_law, load_scenario
    >>> records = fly_direct(load_scenario("gust-roll"), load_law("flagship"))
    >>> print(records)
    flagship: 2500 samples, 10 s
    largest angles: roll 0.389, pitch 0.0617, yaw 0.0393 deg
    rms of angles: roll 0.0786, pitch 0.0286, yaw 0.0159 deg
    largest torques: roll 0.991, pitch 0.395, yaw 0.231 N m
    """

    name: str
    """Law or controller that flew; empty if unknown."""

    @classmethod
    def of(cls, records: Records, name: str = "") -> Self:
        """Return a view of journal records (n,)."""
        found: Self = np.asarray(records).view(cls)
        found.name = name
        return found

    def __array_finalize__(self, source: Any) -> None:
        """Keep the name in views and copies."""
        self.name = getattr(source, "name", "")

    def __getitem__(self, key: Any) -> Any:
        """Return a field as a plain array, or some of the records."""
        part = super().__getitem__(key)
        return np.asarray(part) if isinstance(key, str | list) else part

    def __str__(self) -> str:
        """Return the figures in a few lines; other numbers as an array does."""
        return super().__str__() if self.dtype.names and self.ndim == 1 else str(np.asarray(self))

    __repr__ = __str__

    @property
    def euler_deg(self) -> Array:
        """(n, 3) [deg] roll, pitch and yaw; roll and yaw continue beyond half a turn."""
        return np.degrees(np.unwrap(euler_angles(self["q_NB"]), axis=0))

    def lines(self) -> list[str]:
        """Return what flew, and how far it turned."""
        if not len(self):
            return [f"{self.name or 'flight'}: no samples"]
        time_s = self["time_us"] * 1e-6
        span = time_s[-1] - time_s[0] + (time_s[1] - time_s[0] if len(self) > 1 else 0.0)
        angles, torques = self.euler_deg, self["torque_command_B"]
        return [
            f"{self.name or 'flight'}: {len(self)} samples, {span:.4g} s",
            f"largest angles: {_by_axis(np.abs(angles).max(axis=0))} deg",
            f"rms of angles: {_by_axis(np.sqrt(np.mean(angles**2, axis=0)))} deg",
            f"largest torques: {_by_axis(np.abs(torques).max(axis=0))} N m",
        ]

    def to_arrow(self) -> "pyarrow.Table":
        """Return a table of columns: time [s], Euler angles [deg], then each number of the journal, units there."""
        import pyarrow as pa

        columns: dict[str, Array] = {"time_s": self["time_us"] * 1e-6}
        columns |= dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), self.euler_deg.T, strict=True))
        for field in (name for name in self.dtype.names or () if name not in ("time_us", "unused")):
            values = self[field].reshape(len(self), -1)
            parts = _PARTS.get(field, ("x", "y", "z") if values.shape[1] == 3 else range(1, values.shape[1] + 1))
            names = [field] if values.shape[1] == 1 else [f"{field}.{part}" for part in parts]
            columns |= dict(zip(names, values.T, strict=True))
        return pa.table({name: np.ascontiguousarray(values) for name, values in columns.items()})


def _by_axis(values: Array) -> str:
    return ", ".join(f"{axis} {value:.3g}" for axis, value in zip(AXES, values, strict=True))
