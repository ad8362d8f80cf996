"""One HTML file on a judgement: verdict and evidence, the loop with its limits, and the flights that show it."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from html import escape
from itertools import product
from pathlib import Path

import numpy as np

from firmware_model.config.files import write_text
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.types import AXES
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.law.form import Law
from gustproof.robust.lti.state_space import ComplexMatrix
from gustproof.show.report.html.charts import ChartGroup, ChartKind, Curve, decibels, frequency_chart
from gustproof.show.report.html.marks import Mark
from gustproof.show.report.html.markup import escape_code, render_list, render_table, render_tile_line, render_tiles
from gustproof.show.report.html.page import render_page
from gustproof.show.report.html.runs import ReportRun
from gustproof.show.report.judgement import (
    COLUMNS,
    COMPARED,
    IN_STEPS,
    describe_spread_peak,
    iter_comparison,
    iter_evidence,
    iter_margins,
    title,
)
from gustproof.studies.rate.hover_loop import loop_response
from gustproof.studies.rate.improvement import Improvement
from gustproof.studies.rate.judge import NOMINAL_PEAK, SPREAD_PEAK, Judgement, Verdict
from gustproof.types import Array
from gustproof.version import software_versions

_CORNERS = ("light, fast", "light, slow", "heavy, fast", "heavy, slow")
"""Corners of inertia and lag, in the order of their product."""
_PEAK_MARKS = (
    Mark(label=f"nominal ≤ {NOMINAL_PEAK:g}", y=20.0 * math.log10(NOMINAL_PEAK)),
    Mark(label=f"spreads ≤ {SPREAD_PEAK:g}", y=20.0 * math.log10(SPREAD_PEAK)),
)
_FIRST = "in the air"
"""Flights that are drawn at first: the judged gains and the better ones in the same air."""
_MOST_GAIN = 100.0
"""[-] loop gain of the nominal vehicle above which frequencies are not drawn."""


def write_judgement(found: Judgement, better: Improvement | None, remarks: tuple[str, ...], path: Path) -> None:
    """Write the page; the same judgement gives the same bytes."""
    write_text(path, render_judgement_page(found, better, remarks))


def render_judgement_page(found: Judgement, better: Improvement | None, remarks: tuple[str, ...]) -> str:
    """Return the page as HTML."""
    improved = None if better is None else better.better
    loops = [loop_charts(each) for each in (found, improved) if each is not None]
    runs = tuple(_flights(found, improved))
    return render_page(
        runs,
        title=f"{found.law.name} on '{found.vehicle.name}'",
        intro=render_verdict(found, better, remarks),
        loops=[group for groups in loops for group in groups],
        hidden=[run.label for run in runs if not run.label.endswith(_FIRST)],
    )


def render_verdict(found: Judgement, better: Improvement | None, remarks: tuple[str, ...]) -> str:
    """Return the section of the verdict as HTML, with better gains if there are any."""
    mark = "good" if found.verdict is Verdict.SOUND else "bad"
    parts = [f'<h2 class="{mark}">{escape(title(found))}</h2>', _render_headline(found, better)]
    parts.append(render_list(found.reasons))
    if found.axes:
        margins = render_table(COLUMNS, [[escape(cell) for cell in row] for row in iter_margins(found)])
        parts.append(f"<h3>Margins over the spreads</h3><p class='note'>{escape(found.box.describe())}</p>{margins}")
    parts.append(f"<h3>Evidence</h3>{render_list([f'{name}: {text}' for name, text in iter_evidence(found)])}")
    if found.advice:
        advice = render_list([each.describe() for each in found.advice])
        parts.append(f"<h3>Advice, each change by itself, predicted</h3>{advice}")
    if better is not None:
        parts.append(_render_better(better))
    parts += [f"<p class='note'>{escape_code(remark)}</p>" for remark in remarks]
    return f'<section id="verdict">{"".join(parts)}</section>'


def _render_better(better: Improvement) -> str:
    rows = [[escape(name), *map(escape, cells)] for name, cells in iter_comparison(better)]
    note = f"<p class='note'>{IN_STEPS}</p>" if better.is_for_autopilot else ""
    return f"<h3>Better gains: {escape(better.describe())}</h3>{render_table(COMPARED, rows)}{note}"


def _render_headline(found: Judgement, better: Improvement | None) -> str:
    """Return error, slew, peak sensitivity and worst gust as tiles, a line for each law."""
    judged = [found] if better is None else [found, better.better]
    tiles = []
    for heading, figure in _TILES.items():
        lines = [render_tile_line(i, each.law.name, *figure(each)) for i, each in enumerate(judged)]
        tiles.append((heading, lines))
    return render_tiles(tiles)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _describe_peak(found: Judgement) -> tuple[str, str]:
    if found.Ms_over_spreads is None:
        return _number(found.Ms), ""
    found_only = "" if found.is_proved else "found "
    return _number(found.Ms), f"{found_only}{describe_spread_peak(found)}"


def _describe_gust(found: Judgement) -> tuple[str, str]:
    bound = found.proof.estimate_deg if found.proof is not None else None
    proof = f"≤ {max(bound):.3g}" if bound else "not proved"
    return _number(found.gust.peak_deg if found.gust is not None else None), proof


_TILES: dict[str, Callable[[Judgement], tuple[str, str]]] = {
    "Predicted error <small>deg; beside: least possible</small>": lambda found: (
        _number(found.rmse_deg),
        "" if found.least_rmse_deg is None else _number(found.least_rmse_deg),
    ),
    "Torque slew <small>N m/s</small>": lambda found: (_number(found.slew), ""),
    "Ms <small>beside: over the spreads</small>": _describe_peak,
    "Largest angle in the worst gust found <small>deg; beside: proved bound</small>": _describe_gust,
}
"""Heading as HTML, value and remark of each tile."""


def loop_charts(found: Judgement) -> Iterator[ChartGroup]:
    """Yield Bode plot and sensitivity of each axis: the nominal vehicle and the corners of the spreads, with limits."""
    box, vehicle = found.box, found.vehicle
    corners = [
        replace(vehicle, inertia_B=each, actuator_lag=lag) for each, lag in product((box.low, box.high), box.lag)
    ]
    responses = [loop_response(found.law, each, found.scenario) for each in (vehicle, *corners)]
    omega, nominal = responses[0]
    shown = np.max(np.abs(nominal), axis=1) <= _MOST_GAIN
    names, omega = ("nominal", *_CORNERS), omega[shown]
    bode, phase, peaks = [], [], []
    for axis, name in enumerate(AXES):
        L = [loop[shown, axis] for _, loop in responses]
        gains = _curves(names, omega, (decibels(np.abs(each)) for each in L))
        bode.append(frequency_chart(f"{name}: |L| [dB]", gains, ChartKind.DECIBEL, (Mark(label="0 dB", y=0.0),)))
        phases, turn = _curves(names, omega, map(_phase, L)), Mark(label="−180°", y=-180.0)
        phase.append(frequency_chart(f"{name}: phase of L [deg]", phases, ChartKind.SEMILOG, (turn,)))
        S = _curves(names, omega, (decibels(1.0 / np.abs(1.0 + each)) for each in L))
        peaks.append(frequency_chart(f"{name}: |S| [dB]", S, ChartKind.DECIBEL, _PEAK_MARKS))
    note = "Corners of the spreads are sampled. Dotted: 0 dB, -180 deg, and the largest |S| of a sound law."
    for what, charts in (("Loop gain", bode), ("Loop phase", phase), ("Sensitivity", peaks)):
        yield ChartGroup(title=f"{what}, {found.law.name}, over the spreads", charts=tuple(charts), note=note)


def _curves(names: tuple[str, ...], omega: Array, values: Iterable[Array]) -> tuple[Curve, ...]:
    """Return a curve for each vehicle, the nominal one last, on top."""
    curves = [
        Curve(label=name, colour=i, x=omega, y=each) for i, (name, each) in enumerate(zip(names, values, strict=True))
    ]
    return (*curves[1:], curves[0])


def _phase(L: ComplexMatrix) -> Array:
    """Return the phase [deg], unwrapped, from -360 to 0 at the least frequency."""
    phase = np.degrees(np.unwrap(np.angle(L)))
    return np.asarray(phase - 360.0 * np.ceil(phase[0] / 360.0))


def _flights(found: Judgement, better: Judgement | None) -> Iterator[ReportRun]:
    """Yield flights in the air and in the worst gust, before and after, and where the law fails."""
    laws = [("", found.law), *([("better, ", better.law)] if better is not None else [])]
    scenes = [(_FIRST, found.scenario, found.vehicle)]
    if found.gust is not None:
        scenes.append(("worst gust", found.gust.scenario, found.gust.vehicle))
    if found.failure is not None:
        scenes.append(("where it fails", found.failure.scenario, found.failure.vehicle))
    for (which, law), (what, scenario, vehicle) in product(laws, scenes):
        if law.dt == scenario.dt:
            yield fly_run(f"{which}{what}", law, scenario, vehicle, 1 if found.gust is None else found.gust.seed)


def fly_run(label: str, law: Law, scenario: Scenario, vehicle: Vehicle, seed: int) -> ReportRun:
    """Return a flight for a page, flown now without messages."""
    return ReportRun(
        scenario=scenario,
        controller=law,
        vehicle=vehicle,
        seed=seed,
        records=fly_direct(scenario, law, vehicle=vehicle, seed=seed),
        outcome=FlightOutcome.DONE,
        message=FlightOutcome.DONE.value,
        label=label,
        versions=software_versions(),
    )
