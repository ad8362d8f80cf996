"""One HTML file on an identification, which needs no network."""

import re
from collections.abc import Iterable, Iterator
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import write_text
from gustproof.logs.identify.air import IdentifiedAir
from gustproof.logs.identify.identification import Identification
from gustproof.show.report.html.charts import (
    Chart,
    ChartGroup,
    ChartKind,
    Curve,
    CurveStyle,
    decimate,
    frequency_chart,
)
from gustproof.show.report.html.markup import fill_page, render_table
from gustproof.show.report.html.page import NumberBlock, chart_parts
from gustproof.show.report.vehicle_numbers import AXES, number_rows
from gustproof.types import Array
from gustproof.version import __version__

_BINS_A_DECADE = 20
_GAP_S = 0.1  # no line is drawn across it
_HELD_OUT = 2.0 / 3.0  # begin of the stretch that the model did not see, as a share of the whole


def write_identification_report(
    found: Identification, air: IdentifiedAir | None, findings: Iterable[str], path: Path
) -> None:
    """Write the page on an identification; the same one gives the same bytes."""
    write_text(path, render_identification_page(found, air, findings))


def render_identification_page(found: Identification, air: IdentifiedAir | None, findings: Iterable[str]) -> str:
    """Return the page as HTML."""
    numbers = NumberBlock()
    held_out = np.arange(len(found.time)) >= _HELD_OUT * len(found.time)
    span = found.time[held_out][[0, -1]].tolist() if np.any(held_out) else [0.0, 1.0]
    sections = {
        "response": numbers.encode_groups(_response_groups(found)),
        "air": numbers.encode_groups(() if air is None else _air_groups(air, found)),
        "prediction": numbers.encode_groups(_prediction_groups(found, held_out) if np.any(held_out) else ()),
    }
    page = {"sections": sections, "span": span, "name": re.sub(r"[^\w.-]+", "-", found.source)}
    head = ["95 % intervals in brackets", *AXES]
    parts = {
        "title": escape(f"Identified from {found.source}"),
        "about": "".join(f"<p class='bad'>{escape(line)}</p>" for line in findings),
        "table": render_table(head, [[*map(escape, row)] for row in number_rows(found, air)]),
        "footer": f"Identified and drawn by gustproof {__version__}.",
    }
    return fill_page("identification.html", parts | chart_parts(page, numbers, ("identification.js",)))


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


def _prediction_groups(found: Identification, held_out: NDArray[np.bool_]) -> Iterator[ChartGroup]:
    """Yield prediction and measurement on the held-out stretch, and their difference."""
    time, shown = found.time[held_out], [k for k in range(3) if not found.axes[k].advice]
    predictions, residuals = [], []
    for k in shown:
        measured, predicted = found.acceleration[held_out, k], found.predicted[held_out, k]
        title = f"{AXES[k]} [rad/s²]"
        curves = (_history("measured", 0, time, measured), _history("predicted from commands", 1, time, predicted))
        predictions.append(Chart(title=title, x_label="time [s]", kind=ChartKind.TIME, curves=curves))
        residual = (_history("measured less predicted", 2, time, measured - predicted),)
        residuals.append(Chart(title=title, x_label="time [s]", kind=ChartKind.TIME, curves=residual))
    if shown:
        note = "The model was fitted to the rest of the flight."
        yield ChartGroup(title="Angular acceleration, held-out third", charts=tuple(predictions), note=note)
        yield ChartGroup(title="Residual", charts=tuple(residuals))


def _history(label: str, colour: int, time: Array, values: Array) -> Curve:
    broken = np.where(np.diff(time, prepend=time[0]) > _GAP_S, np.nan, values)
    return _curve(label, colour, *decimate(time, broken))


def _curve(label: str, colour: int, x: Array, y: Array, style: CurveStyle = CurveStyle.SOLID) -> Curve:
    return Curve(label=label, colour=colour, x=x, y=y, style=style)


def _bin(omega: Array, density: Array) -> tuple[Array, Array]:
    """Return the mean of a density within bins of equal width in the logarithm of frequency."""
    number = np.floor(np.log10(omega) * _BINS_A_DECADE).astype(np.int64)
    _, index, count = np.unique(number, return_inverse=True, return_counts=True)
    return np.bincount(index, omega) / count, np.bincount(index, density) / count
