"""Charts of the page as groups of curves, and those of time histories and spectra."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from firmware_model.autopilot.modes import Mode
from firmware_model.config.vehicle import MOST_ROTORS
from gustproof.flight.scoring.metrics import attitude, command_limit
from gustproof.show.report.html.marks import History, Mark, limit_marks
from gustproof.show.report.html.runs import ReportRun
from gustproof.show.report.thinned import decimate
from gustproof.types import Array

_SEGMENTS = 4  # without overlap; Welch's method overlaps them by half and averages seven spectra

Values = Callable[[ReportRun], Array]


class ChartKind(Enum):
    """Axes of a chart."""

    TIME = "time"  # time and a value; all charts of time share zoom and cursor
    FREQUENCY = "frequency"  # both logarithmic
    DECIBEL = "decibel"  # frequency, logarithmic, and a gain in dB, 90 dB at most
    SEMILOG = "semilog"  # frequency, logarithmic, and a value
    LINEAR = "linear"  # two values
    PLANE = "plane"  # the complex plane, both axes logarithmic away from 0; points without lines


class CurveStyle(Enum):
    """Style of a curve."""

    SOLID = "solid"  # a line
    DASHED = "dashed"  # a dashed line: a bound or a reference
    HOLLOW = "hollow"  # rings instead of dots, in the complex plane


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One curve."""

    label: str
    """Name in the legend."""
    colour: int | None
    """Index in the palette; `None` is the colour of text."""
    x: Array
    """(n,) ascending [unit of the chart's x]; in the plane in any order."""
    y: Array
    """(n,) [unit of the chart's y]."""
    style: CurveStyle = CurveStyle.SOLID
    """Line style."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chart:
    """One pair of axes."""

    title: str
    """Quantity and unit of y."""
    x_label: str
    """Quantity and unit of x."""
    kind: ChartKind
    """Axes."""
    curves: tuple[Curve, ...]
    """Curves, the lowest first."""
    marks: tuple[Mark, ...] = ()
    """Limits and crossovers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChartGroup:
    """Charts side by side, exported as one picture."""

    title: str
    """Heading."""
    charts: tuple[Chart, ...]
    """The charts."""
    note: str = ""
    """Explanation below the heading."""


def _field(name: str) -> Values:
    return lambda run: np.asarray(run.records[name])


def _in_degrees(name: str) -> Values:
    """Return angular rates in deg/s, the unit of all pages."""
    return lambda run: np.degrees(run.records[name])


def _torque_share(run: ReportRun) -> Array:
    share = np.abs(run.records["torque_command_B"]) / command_limit(run.vehicle, run.law)
    return np.asarray(np.max(share, axis=1, keepdims=True))


_HISTORIES: tuple[tuple[History, tuple[str, ...], Values], ...] = (
    (History.ATTITUDE, ("roll φ [deg]", "pitch θ [deg]", "yaw ψ [deg]"), lambda run: np.degrees(attitude(run.records))),
    (History.RATES, ("p [deg/s]", "q [deg/s]", "r [deg/s]"), _in_degrees("omega_B")),
    (History.COMMANDED_RATES, ("p [deg/s]", "q [deg/s]", "r [deg/s]"), _in_degrees("omega_command_B")),
    (History.COMMANDED_TORQUE, ("roll [N m]", "pitch [N m]", "yaw [N m]"), _field("torque_command_B")),
    (History.ACTUATOR_TORQUE, ("roll [N m]", "pitch [N m]", "yaw [N m]"), _field("torque_B")),
    (History.SATURATION, ("largest share of a torque limit [-]; 1 is saturated",), _torque_share),
    (History.GUST, ("forward u [m/s]", "right v [m/s]", "down w [m/s]"), _field("gust_B")),
    (History.ANGULAR_GUST, ("roll [deg/s]", "pitch [deg/s]", "yaw [deg/s]"), _in_degrees("gust_omega_B")),
    (History.MEAN_WIND, ("north [m/s]", "east [m/s]", "down [m/s]"), _field("wind_N")),
    (History.MOMENT, ("roll [N m]", "pitch [N m]", "yaw [N m]"), _field("moment_B")),
    (History.THRUST, tuple(f"rotor {i + 1} [N]" for i in range(MOST_ROTORS)), _field("rotors")),
    (History.POSITION, ("north [m]", "east [m]", "down [m]"), _field("position_N")),
    (History.VELOCITY, ("north [m/s]", "east [m/s]", "down [m/s]"), _field("velocity_N")),
    (History.LINK, ("age of the acting command [samples]",), _field("command_age")),
)
"""Kind, axes and values (n, k) of each group of time histories; constant groups are left out."""

_SPECTRA = (History.ATTITUDE, History.GUST, History.MOMENT)


def _number_modes(runs: Sequence[ReportRun]) -> tuple[History, tuple[str, ...], Values]:
    """Return a history of the modes by their places in its axis' title, as their own numbers tell nothing."""
    modes = np.concatenate([run.records["mode"] for run in runs])
    flown = np.unique(modes[~np.isnan(modes)])
    names = {mode.value: mode.name for mode in Mode}
    title = ", ".join(f"{i} {names.get(int(mode), f'number {mode:.0f}')}" for i, mode in enumerate(flown))

    def places(run: ReportRun) -> Array:
        mode = run.records["mode"][:, np.newaxis]
        return np.where(np.isnan(mode), np.nan, np.searchsorted(flown, mode))

    return History.AUTOPILOT, (f"mode: {title}",), places


def _is_known(values: Array, k: int) -> bool:
    """Return whether the values (n, columns) have a number in column k."""
    return k < values.shape[1] and not np.all(np.isnan(values[:, k]))


def time_histories(runs: Sequence[ReportRun]) -> tuple[ChartGroup, ...]:
    """Return the time histories. What is constant in every run is a line of its group; without a chart no group is."""
    return tuple(filter(None, (_history_group(runs, *each) for each in (*_HISTORIES, _number_modes(runs)))))


def _history_group(
    runs: Sequence[ReportRun], history: History, axes: Sequence[str], values: Values
) -> ChartGroup | None:
    known = _known_columns([values(run) for run in runs], len(axes))
    still = {k: _constant([column for _, column in found]) for k, found in known.items()}
    if all(value is not None for value in still.values()):
        return None
    folded = {} if history is History.ATTITUDE else {k: value for k, value in still.items() if value is not None}
    charts = tuple(_history_chart(runs, history, k, axes[k], found) for k, found in known.items() if k not in folded)
    constant = ", ".join(f"{axes[k].partition(' [')[0]} {value:.4g}" for k, value in folded.items())
    note = f"Constant, not drawn: {constant}." if constant else ""
    return ChartGroup(title=history.value, charts=charts, note=note)


def _known_columns(values: Sequence[Array], most: int) -> dict[int, list[tuple[int, Array]]]:
    """Return, for each of at most `most` columns, those of the runs' values (n, columns) that have a number.

    Each stands behind the place of its run. The most agitated run comes first: drawn last it would hide the others.
    """
    agitation = [float(np.nansum(np.abs(np.diff(each, axis=0)))) for each in values]
    order = sorted(range(len(values)), key=lambda i: -agitation[i])
    known = {k: [(i, values[i][:, k]) for i in order if _is_known(values[i], k)] for k in range(most)}
    return {k: found for k, found in known.items() if found}


def _history_chart(
    runs: Sequence[ReportRun], history: History, k: int, axis: str, columns: Iterable[tuple[int, Array]]
) -> Chart:
    """Return chart `k` of a group, of the `columns` (n,) of some runs, which are told by their places."""
    curves = merge_curves([_history_curve(runs[i], column, i) for i, column in columns], "all runs")
    references = _reference_curves(runs, k) if history is History.ATTITUDE else ()
    marks = limit_marks(runs, history, k)
    return Chart(title=axis, x_label="time [s]", kind=ChartKind.TIME, curves=(*curves, *references), marks=marks)


def _constant(columns: Sequence[Array]) -> float | None:
    """Return the one value that all columns (n,) have from their first known sample on; `None` if there is none."""
    known = np.concatenate([column[int(np.argmin(np.isnan(column))) :] for column in columns])
    return float(known[0]) if np.all(known == known[0]) else None


def spectra(runs: Sequence[ReportRun]) -> tuple[ChartGroup, ...]:
    """Return power spectral densities, one-sided over the angular frequency, by Welch's method.

    References
    ----------
    P. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Transactions on Audio and
    Electroacoustics 15, 1967.
    """
    groups = []
    flown = [(i, run) for i, run in enumerate(runs) if len(run.records) > 1]
    for history, axes, values in (each for each in _HISTORIES if each[0] in _SPECTRA):
        found = [_spectrum(values(run), run.scenario.dt) for _, run in flown]
        charts = []
        for k, axis in enumerate(axes):
            name, unit = axis.rstrip("]").split(" [")
            curves = [
                Curve(label=run.label, colour=i, x=omega, y=density[:, k])
                for (i, run), (omega, density) in zip(flown, found, strict=True)
                if np.all(density[:, k] > 0.0)
            ]
            label = f"{name} [{bracket_unit(unit)}²/(rad/s)]"
            if curves:
                charts.append(frequency_chart(label, merge_curves(curves, "all runs")))
        if charts:
            groups.append(
                ChartGroup(title=f"Spectrum: {history.value.partition(',')[0].lower()}", charts=tuple(charts))
            )
    return tuple(groups)


def frequency_chart(
    title: str, curves: tuple[Curve, ...], kind: ChartKind = ChartKind.FREQUENCY, marks: tuple[Mark, ...] = ()
) -> Chart:
    """Return a chart over frequency."""
    return Chart(title=title, x_label="frequency [rad/s]", kind=kind, curves=curves, marks=marks)


def decibels(gains: Array) -> Array:
    """Return gains in dB; those below 1e-15 as that."""
    return np.asarray(20.0 * np.log10(np.maximum(gains, 1e-15)))


def bracket_unit(unit: str) -> str:
    """Return a unit for use in a product: in brackets if it is a product itself."""
    return f"({unit})" if set(unit) & {"/", " "} else unit


def merge_curves(curves: Iterable[Curve], label: str) -> tuple[Curve, ...]:
    """Return the curves, or a single one named `label` if they are equal and would hide each other."""
    found = tuple(curves)
    if len(found) < 2 or not all(_is_same(found[0], curve) for curve in found[1:]):
        return found
    return (replace(found[0], label=label, colour=None),)


def _is_same(one: Curve, other: Curve) -> bool:
    return np.array_equal(one.x, other.x) and np.array_equal(one.y, other.y, equal_nan=True)


def _history_curve(run: ReportRun, column: Array, colour: int) -> Curve:
    time, values = decimate(run.records["time_us"] * 1e-6, column)
    return Curve(label=run.label, colour=colour, x=time, y=values)


def _reference_curves(runs: Sequence[ReportRun], axis: int) -> tuple[Curve, ...]:
    """Return the reference angles [deg] about an axis; references common to all runs become one curve."""
    curves = []
    for i, run in enumerate(runs):
        if references := run.scenario.references:
            stamps, angles = zip((-1, (0.0, 0.0, 0.0)), *references, strict=True)
            held = np.degrees(angles)[np.searchsorted(stamps, run.records["time_us"], side="right") - 1, axis]
            dashed = replace(_history_curve(run, held, i), style=CurveStyle.DASHED)
            curves.append(replace(dashed, label=f"reference of {run.label}"))
    if all(_is_same(curves[0], curve) for curve in curves[1:]):
        return tuple(replace(curve, label="reference", colour=None) for curve in curves[:1])
    return tuple(curves)


def _spectrum(values: Array, dt: float) -> tuple[Array, Array]:
    """Return angular frequencies (m,) [rad/s] above 0 and densities (m, k) of `values` (n, k), by Welch's method.

    It is that of `scipy.signal`, whose import takes longer than all other work of a page.
    """
    n = max(len(values) // _SEGMENTS, 2)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi / n * np.arange(n))
    segments = np.lib.stride_tricks.sliding_window_view(values, n, axis=0)[:: n - n // 2]
    found = np.fft.rfft(window * (segments - np.mean(segments, axis=-1, keepdims=True)))
    power = np.mean(np.abs(found) ** 2, axis=0).T * dt / np.sum(window**2)
    density = np.asarray(power / (2.0 * np.pi), dtype=np.float64)
    density[1 : None if n % 2 else -1] *= 2.0  # negative frequencies, of which 0 and the highest have none
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(n, dt), dtype=np.float64)
    return omega[1:], density[1:]
