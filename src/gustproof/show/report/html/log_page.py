"""One HTML file on a flight's log, which needs no network: flight, loops, vibration, vehicle and verdict."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from firmware_model.config.files import write_text
from firmware_model.types import AXES
from gustproof.logs.identify.air import IdentifiedAir
from gustproof.logs.identify.flown_step import SHOWN_S, FlownStep, Loop
from gustproof.logs.identify.gyro_spectrum import LOWEST_HZ, GyroSpectrum
from gustproof.logs.identify.identification import Identification
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.show.report.html.charts import (
    Chart,
    ChartGroup,
    ChartKind,
    Curve,
    CurveStyle,
    frequency_chart,
)
from gustproof.show.report.html.judgement_page import loop_charts, render_verdict
from gustproof.show.report.html.marks import Mark
from gustproof.show.report.html.markup import escape_code, fill_page, render_list, render_table
from gustproof.show.report.html.page import NumberBlock, chart_parts
from gustproof.show.report.log_summary import describe_vibration, doubts, filter_rows, signal_rows, summary
from gustproof.show.report.thinned import decimate
from gustproof.show.report.vehicle_numbers import number_rows
from gustproof.studies.logged_flight import LoggedFlight
from gustproof.types import Array
from gustproof.version import __version__

_BINS_A_DECADE = 20
_GAP_S = 0.1  # no line is drawn across it


def write_log_report(flight: LoggedFlight, path: Path) -> None:
    """Write the page on a log; the same one gives the same bytes."""
    write_text(path, render_log_page(flight))


def render_log_page(flight: LoggedFlight) -> str:
    """Return the page as HTML."""
    numbers, log = NumberBlock(), flight.log
    page = {
        "sections": {name: numbers.encode_groups(groups) for name, groups in _chart_groups(flight).items()},
        "span": [0.0, float(log.gyro.time[-1])],
        "name": re.sub(r"[^\w.-]+", "-", log.source),
    }
    head, *filters = [_escape(row) for row in filter_rows(flight.filters)] or [[]]
    vehicle = [] if flight.shown is None else [_escape(row) for row in number_rows(flight.shown)]
    parts = {
        "title": escape(f"Flight of {log.source}"),
        "about": "".join(
            f"<p>{escape_code(line)}</p>" for line in summary(flight, has_verdict=flight.judgement is not None)
        ),
        "signals": render_table(("signal", "rate [Hz]", "samples"), map(_escape, signal_rows(log))),
        "findings": render_list(log.findings),
        "steps": render_list([*(each.describe() for each in flight.steps), *flight.not_told]),
        "lines": render_list([*describe_vibration(flight)]),
        "filters": render_table(head, filters),
        "vehicle": render_table(["95 % intervals in brackets", *AXES], vehicle),
        "doubts": render_list([line for line in doubts(flight) if line not in log.findings]),
        "verdict": "" if flight.judgement is None else render_verdict(flight.judgement, None, flight.remarks),
        "footer": f"Read and drawn by gustproof {__version__}.",
    }
    return fill_page("log.html", parts | chart_parts(page, numbers, ("log.js",)))


def _chart_groups(flight: LoggedFlight) -> dict[str, Iterable[ChartGroup]]:
    """Return the charts of each section."""
    found = None if flight.shown is None else flight.shown.identification
    air = None if flight.shown is None else flight.shown.air
    return {
        "flight": _history_groups(flight.log),
        "steps": _step_groups(flight.steps),
        "spectra": () if flight.spectrum is None else _spectrum_groups(flight.spectrum),
        "response": () if found is None else _response_groups(found),
        "air": () if found is None or air is None else _air_groups(air, found),
        "prediction": () if found is None else _prediction_groups(found),
        "loops": () if flight.judgement is None else loop_charts(flight.judgement),
    }


def _escape(row: Iterable[str]) -> list[str]:
    return [*map(escape, row)]


def _history_groups(log: FlightLog) -> Iterator[ChartGroup]:
    """Yield what was asked for over what was flown, and the commands that did it."""
    motors = 0 if log.motors is None else log.motors.values.shape[1]
    unit = "-" if log.command_unit.value == "1" else log.command_unit.value
    for title, axes, unit_of, measured, asked in (
        ("Attitude", AXES, "deg", log.attitude, log.reference),
        ("Rates", tuple("pqr"), "deg/s", log.gyro, log.rate_reference),
        ("Torque command", AXES, unit, log.command, None),
        ("Motors", tuple(f"motor {k + 1}" for k in range(motors)), "-", log.motors, None),
    ):
        if measured is not None:
            charts = tuple(_history_chart(k, f"{axis} [{unit_of}]", measured, asked) for k, axis in enumerate(axes))
            yield ChartGroup(title=title, charts=charts)


def _history_chart(k: int, title: str, measured: LogSignal, asked: LogSignal | None) -> Chart:
    scale = math.degrees(1.0) if "[deg" in title else 1.0
    curves = [_history("flown" if asked else "logged", 0, measured.time, scale * measured.values[:, k])]
    if asked is not None:
        curves.append(_history("set-point", 1, asked.time, scale * asked.values[:, k], CurveStyle.DASHED))
    return Chart(title=title, x_label="time [s]", kind=ChartKind.TIME, curves=tuple(curves))


def _step_groups(steps: Sequence[FlownStep]) -> Iterator[ChartGroup]:
    """Yield the step responses of each loop with their intervals."""
    for loop, title in ((Loop.RATE, "Rate loop"), (Loop.ATTITUDE, "Attitude loop")):
        charts = []
        for each in (each for each in steps if each.loop is loop):
            curves = (
                _curve("95 % interval, low", 2, each.time, each.low, CurveStyle.DASHED),
                _curve("95 % interval, high", 2, each.time, each.high, CurveStyle.DASHED),
                _curve("response", 0, each.time, each.value),
            )
            marks = (Mark(label="set-point", y=1.0),)
            name = f"{AXES[each.axis]} [-]"
            charts.append(
                Chart(title=name, x_label="time from the step [s]", kind=ChartKind.LINEAR, curves=curves, marks=marks)
            )
        if charts:
            note = f"Fitted to the whole flight, shown for {SHOWN_S[loop]:g} s: what was flown after a set-point of 1."
            yield ChartGroup(title=f"{title}: response to a step", charts=tuple(charts), note=note)


def _spectrum_groups(spectrum: GyroSpectrum) -> Iterator[ChartGroup]:
    """Yield the spectrum of the gyro, by throttle where that moves."""
    marks = tuple(Mark(label=f"{line.hertz:.0f} Hz", x=(line.hertz, line.hertz)) for line in spectrum.lines)
    charts = []
    for k, axis in enumerate(AXES):
        curves = [_curve("whole flight", None, spectrum.hertz, spectrum.density[k])]
        curves += [
            _curve(f"throttle {level:.2f}", i, spectrum.hertz, each[k])
            for i, (level, each) in enumerate(zip(spectrum.throttle, spectrum.by_throttle, strict=True))
        ]
        title = f"{axis} [(rad/s)²/Hz]"
        charts.append(
            Chart(title=title, x_label="frequency [Hz]", kind=ChartKind.FREQUENCY, curves=tuple(curves), marks=marks)
        )
    note = f"Above {LOWEST_HZ:g} Hz a vehicle vibrates. Faster vibration than {spectrum.hertz[-1]:.0f} Hz folds down."
    yield ChartGroup(title="Spectrum of the gyro", charts=tuple(charts), note=note)


def _response_groups(found: Identification) -> Iterator[ChartGroup]:
    """Yield magnitude, phase and coherence of each axis that is identified, measured and of the model."""
    known = [k for k in range(3) if not found.axes[k].advice]
    responses = {"measured": found.response, "model": found.model}
    styles = {"measured": CurveStyle.SOLID, "model": CurveStyle.DASHED}

    def charts(title: str, kind: ChartKind, values: dict[str, Array]) -> tuple[Chart, ...]:
        return tuple(
            frequency_chart(
                f"{AXES[k]} {title}",
                tuple(
                    _curve(name, i, found.omega, each[k], styles[name]) for i, (name, each) in enumerate(values.items())
                ),
                kind,
            )
            for k in known
        )

    magnitude = {name: np.abs(each) for name, each in responses.items()}
    phase = {name: np.degrees(np.unwrap(np.angle(each), axis=1)) for name, each in responses.items()}
    unit = "" if found.command_unit.value == "1" else f"/({found.command_unit.value})"
    shown = (
        ("Angular acceleration per command", charts(f"[rad/s²{unit}]", ChartKind.FREQUENCY, magnitude)),
        ("Its phase", charts("[deg]", ChartKind.SEMILOG, phase)),
        ("Its coherence", charts("[-]", ChartKind.SEMILOG, {"measured": found.coherence})),
    )
    for title, each in shown:
        if each:
            yield ChartGroup(title=title, charts=each)


def _air_groups(air: IdentifiedAir, found: Identification) -> Iterator[ChartGroup]:
    """Yield the spectrum of what the model leaves with its Dryden fit."""
    spectra = []
    for k, axis in enumerate(AXES):
        if found.axes[k].advice:
            continue
        omega, measured = _bin(air.omega, air.measured[k])
        _, whole = _bin(air.omega, air.fitted[k] + air.noise[k])
        curves = (
            _curve("measured", 0, omega, measured),
            _curve("Dryden turbulence", 1, air.omega, air.fitted[k], CurveStyle.DASHED),
            _curve("turbulence, gyro noise and model error", 2, omega, whole, CurveStyle.DASHED),
        )
        spectra.append(frequency_chart(f"{axis} [(rad/s²)²/(rad/s)]", curves))
    note = (
        f"As a wind of {air.wind_speed_20ft:.3g} m/s at 20 ft that passes at {air.airspeed:.3g} m/s. "
        "The gyro's noise, differentiated, rises with frequency."
    )
    yield ChartGroup(title="Spectrum of what the model leaves", charts=tuple(spectra), note=note)


def _prediction_groups(found: Identification) -> Iterator[ChartGroup]:
    """Yield prediction and measurement, and their difference."""
    predictions, residuals = [], []
    shown = [k for k in range(3) if not found.axes[k].advice]
    for k in shown:
        measured, predicted = found.acceleration[:, k], found.predicted[:, k]
        title = f"{AXES[k]} [rad/s²]"
        curves = (
            _history("measured", 0, found.time, measured),
            _history("predicted from commands", 1, found.time, predicted),
        )
        predictions.append(Chart(title=title, x_label="time [s]", kind=ChartKind.TIME, curves=curves))
        residual = (_history("measured less predicted", 2, found.time, measured - predicted),)
        residuals.append(Chart(title=title, x_label="time [s]", kind=ChartKind.TIME, curves=residual))
    if shown:
        note = "The model is fitted to all of it. R² is of pieces, every third, that a fit to the others predicts."
        yield ChartGroup(title="Angular acceleration", charts=tuple(predictions), note=note)
        yield ChartGroup(title="Residual", charts=tuple(residuals))


def _history(label: str, colour: int, time: Array, values: Array, style: CurveStyle = CurveStyle.SOLID) -> Curve:
    steps = np.diff(time, prepend=time[0])
    broken = np.where(steps > max(_GAP_S, 3.0 * float(np.median(steps[1:]))), np.nan, values)
    return _curve(label, colour, *decimate(time, broken), style)


def _curve(label: str, colour: int | None, x: Array, y: Array, style: CurveStyle = CurveStyle.SOLID) -> Curve:
    return Curve(label=label, colour=colour, x=x, y=y, style=style)


def _bin(omega: Array, density: Array) -> tuple[Array, Array]:
    """Return the mean of a density within bins of equal width in the logarithm of frequency."""
    number = np.floor(np.log10(omega) * _BINS_A_DECADE).astype(np.int64)
    _, index, count = np.unique(number, return_inverse=True, return_counts=True)
    return np.bincount(index, omega) / count, np.bincount(index, density) / count
