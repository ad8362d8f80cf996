"""One HTML file on some flights, which needs no network.

Tables are plain HTML. Curves are float32 numbers in one block, which the page's script unpacks and draws. The block
holds their bytes in four planes, first bytes with first bytes, which compresses best.
"""

import base64
import json
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from firmware_model.config.files import write_text
from gustproof.show.report.html.charts import Chart, ChartGroup, Curve, spectra, time_histories
from gustproof.show.report.html.loops import collect_laws, frequency_charts, pole_charts
from gustproof.show.report.html.marks import Mark, time_bands
from gustproof.show.report.html.markup import escape_code, fill_page, read_asset, shorten
from gustproof.show.report.html.runs import ReportRun
from gustproof.show.report.html.tables import render_flights, render_headline, render_margins, render_requirements
from gustproof.show.report.thinned import MAX_SAMPLES
from gustproof.types import Array
from gustproof.version import __version__

_SCRIPTS = ("attitude.js", "replay.js", "page.js")
MAX_EXACT = 300_000
"""Numbers of a page that are kept as float32; curves of a page with more are rounded, to keep it below 3 MB."""

_LEVEL = 7
"""zlib's level: 9 takes more than twice as long, for 0.3 % less."""


def write_report(runs: Sequence[ReportRun], path: Path) -> None:
    """Write the page on some flights; the same flights give the same bytes."""
    write_text(path, render_page(runs))


def render_page(
    runs: Sequence[ReportRun],
    *,
    title: str = "",
    intro: str = "",
    first: Sequence[ChartGroup] = (),
    loops: Sequence[ChartGroup] = (),
    hidden: Sequence[str] = (),
) -> str:
    """Return the page as HTML, with a `title` of its own, an `intro` as HTML, and charts before the laws' own loops.

    The intro is a section `verdict`, which ends with the `first` charts.

    Flights whose labels are `hidden` are drawn when their names in the legend are pressed.
    """
    laws, numbers = collect_laws(runs), NumberBlock()
    scenarios = dict.fromkeys(run.scenario.name for run in runs)
    sections = {
        **({"verdict": numbers.encode_groups(first)} if first else {}),
        "time": numbers.encode_groups(time_histories(runs)),
        "frequency": numbers.encode_groups([*loops, *frequency_charts(laws)]),
        "poles": numbers.encode_groups(pole_charts(laws)),
        "spectra": numbers.encode_groups(spectra(runs)),
    }
    page = {
        "runs": [{"label": run.label, **numbers.encode_replay(run)} for run in runs],
        "sections": sections,
        "hidden": list(hidden),
        "bands": time_bands(runs),
        "span": [0.0, max(len(run.records) * run.scenario.dt for run in runs)],
        "name": re.sub(r"[^\w.-]+", "-", ", ".join(scenarios)),
    }
    flown = ", ".join(dict.fromkeys(run.versions["gustproof"] for run in runs))
    thinned = max(len(run.records) for run in runs) > MAX_SAMPLES
    shown = f" Curves of long flights show the extremes of {MAX_SAMPLES // 2} sections." if thinned else ""
    parts = {
        "title": escape(title or f"{shorten(scenarios)}: {shorten(dict.fromkeys(run.pilot_name for run in runs))}"),
        "scenarios": _render_about(runs, warns=not intro),
        "intro": intro,
        "first": '<a href="#verdict">Verdict</a> ' * bool(intro),
        "tiles": render_headline(runs),
        "flights": render_flights(runs),
        "requirements": render_requirements(runs),
        "margins": render_margins(laws),
        "footer": escape(f"Flown by gustproof {flown}, drawn by gustproof {__version__}.{shown}"),
    }
    return fill_page("page.html", parts | chart_parts(page, numbers, _SCRIPTS))


def _render_about(runs: Sequence[ReportRun], *, warns: bool) -> str:
    """Return what was flown, and what must be known before any figure is read.

    A page with a verdict does not warn: it flies gains on purpose where they fail.
    """
    warned = dict.fromkeys(f"{run.label}: {warning}" for run in runs for warning in run.warnings) if warns else {}
    told = "".join(f"<p>{escape_code(text)}</p>" for text in dict.fromkeys(_describe(runs)))
    return told + "".join(f"<p class='bad'>{escape_code(text)}</p>" for text in warned)


def _describe(runs: Sequence[ReportRun]) -> Iterable[str]:
    """Yield what was to be flown, and how each flight ended that did not fly all of it."""
    for run in runs:
        yield f"{run.scenario.name}: {run.scenario.description}"
    for run in runs:
        if not run.has_expected_outcome:
            flown = len(run.records) * run.scenario.dt
            yield f"{run.label}: {run.message}, after {flown:.4g} s of {run.scenario.duration_s:g} s"


def chart_parts(page: Mapping[str, Any], numbers: "NumberBlock", scripts: Iterable[str]) -> dict[str, str]:
    """Return the parts that all pages with charts share: data, numbers, and the scripts that draw them."""
    names = ("uPlot.min.js", "numbers.js", "charts.js", *scripts)
    return {
        "licence": escape(read_asset("uPlot.LICENSE")),
        "policy": "script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:",
        "styles": f"{read_asset('uPlot.min.css')}\n{read_asset('page.css')}",
        # no text in the JSON may end the script
        "page": json.dumps(page, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c"),
        "numbers": numbers.encode(),
        "scripts": "\n".join(f"<script>\n{read_asset(name)}\n</script>" for name in names),
    }


class NumberBlock:
    """All numbers of the page, each array once, referred to by offset and length."""

    def __init__(self) -> None:
        self._arrays: list[bytes] = []
        self._offsets: dict[bytes, tuple[int, int]] = {}
        self._rounded: set[int] = set()
        self._used = 0

    def add(self, values: Array, *, exact: bool = True) -> tuple[int, int]:
        """Return offset and length of `values` (n,), added if they are new; those not `exact` may be rounded."""
        content = np.ascontiguousarray(values, dtype="<f4").tobytes()
        if content not in self._offsets:
            self._offsets[content] = (self._used, len(values))
            if not exact:
                self._rounded.add(len(self._arrays))
            self._arrays.append(content)
            self._used += len(values)
        return self._offsets[content]

    def encode(self) -> str:
        """Return the numbers as base64 of zlib of the four planes of their bytes.

        If they are many, curves are rounded to 15 significant bits, 1 in 65,000: noise in the last bits, which no
        eye sees, is most of a page.
        """
        arrays = [
            _round_bits(content) if i in self._rounded and self._used > MAX_EXACT else content
            for i, content in enumerate(self._arrays)
        ]
        words = np.frombuffer(b"".join(arrays), dtype=np.uint8).reshape(-1, 4)
        return base64.b64encode(zlib.compress(words.T.tobytes(), _LEVEL)).decode()

    def encode_groups(self, groups: Iterable[ChartGroup]) -> list[dict[str, Any]]:
        """Return groups of charts in the form that the page's script reads."""
        return [
            {"title": group.title, "note": group.note, "charts": [*map(self._encode_chart, group.charts)]}
            for group in groups
        ]

    def encode_replay(self, run: ReportRun) -> dict[str, Any]:
        """Return time [s], q_NB and gust_B [m/s] of a run by component, for the 3D replay."""
        records = run.records[:: -(-len(run.records) // MAX_SAMPLES)]
        return {
            "time": self.add(records["time_us"] * 1e-6),
            "q_NB": [self.add(column, exact=False) for column in records["q_NB"].T],
            "gust_B": [self.add(column, exact=False) for column in records["gust_B"].T],
        }

    def _encode_chart(self, chart: Chart) -> dict[str, Any]:
        curves = [self._encode_curve(curve) for curve in chart.curves]
        marks = [*map(_encode_mark, chart.marks)]
        return {"title": chart.title, "x": chart.x_label, "kind": chart.kind.value, "curves": curves, "marks": marks}

    def _encode_curve(self, curve: Curve) -> dict[str, Any]:
        offsets = {"x": self.add(curve.x), "y": self.add(curve.y, exact=False)}
        return {"label": curve.label, "colour": curve.colour, "style": curve.style.value, **offsets}


def _encode_mark(mark: Mark) -> dict[str, Any]:
    return {"label": mark.label, "x": mark.x, "y": mark.y, "colour": mark.colour}


def _round_bits(content: bytes) -> bytes:
    """Return float32 numbers with the last 9 bits of the significand rounded away; NaN and infinities stay."""
    values = np.frombuffer(content, dtype="<f4")
    rounded = ((values.view("<u4") + np.uint32(0x100)) & np.uint32(0xFFFFFE00)).view("<f4")
    return np.where(np.isfinite(rounded), rounded, values).tobytes()
