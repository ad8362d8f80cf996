"""Judgements of laws as tables and text."""

import math
from collections.abc import Iterator

from rich.console import Group
from rich.table import Table
from rich.text import Text

from firmware_model.types import AXES
from gustproof.robust.lti.margins import LoopMargins
from gustproof.show.report.laws import format_margin
from gustproof.show.report.terminal import Renderable
from gustproof.studies.rate.improvement import Improvement, describe_end, least_margins
from gustproof.studies.rate.judge import MOST_SLEW, Judgement

COLUMNS = ("axis", "vehicle", "crossover [rad/s]", "phase [deg]", "gain up", "gain down", "delay [ms]", "Ms")
"""Headings of the margins."""
COMPARED = ("", "now", "better")
"""Headings of the comparison."""
NONE_BETTER = f"no better gains found within {MOST_SLEW:g} times this torque slew, at this Ms or a usual one"
"""Line where better gains were searched in vain."""
IN_STEPS = "Try better gains in steps: hover after each, and feel the motors. Warm ones tell too much torque slew."
"""Line below better gains of an autopilot."""


def render_judgement(found: Judgement, better: Improvement | None = None) -> Renderable:
    """Return verdict, margins, evidence and advice; with `better`, what better gains would bring and cost."""
    table = Table(*COLUMNS, title=f"Margins over the spreads, {found.box.describe()}")
    for row in iter_margins(found):
        table.add_row(*row)
    parts: list[Renderable] = [
        Text(title(found)),
        Text("\n".join(f"- {reason}" for reason in found.reasons)),
        *([table] if found.axes else []),
        Text("\n".join(f"{name}: {text}" for name, text in iter_evidence(found))),
    ]
    if found.advice:
        lines = [f"- {advice.describe()}" for advice in found.advice]
        parts.append(Text("\n".join(["Advice, each change by itself, predicted:", *lines])))
    if better is not None:
        compared = Table(*COMPARED, title=f"Better gains: {better.describe()}")
        for name, cells in iter_comparison(better):
            compared.add_row(name, *cells)
        parts += [compared, *([Text(IN_STEPS)] if better.is_for_autopilot else [])]
    return Group(*parts)


def title(found: Judgement) -> str:
    """Return the verdict in a line."""
    rate, late = found.scenario.control_rate_hz, 1e3 * found.scenario.delay_samples * found.scenario.dt
    where = f"on '{found.vehicle.name}' in '{found.scenario.name}', {rate} Hz, {late:.3g} ms late"
    return f"{found.verdict.value}: {found.law.name} {where}"


def iter_margins(found: Judgement) -> Iterator[tuple[str, ...]]:
    """Yield the rows of `COLUMNS`: each axis with the nominal vehicle, and the worst over the spreads."""
    for name, axis in zip(AXES, found.axes, strict=False):
        yield name, "nominal", *_margins(axis.nominal), f"{axis.nominal.Ms:.3g}"
        peak = f"{_finite(axis.Ms_found)} sampled" if axis.Ms_proved is None else f"≤ {_up(axis.Ms_proved)} proved"
        yield "", "worst of corners", *_margins(axis.worst), peak


def iter_evidence(found: Judgement) -> Iterator[tuple[str, str]]:
    """Yield name and text of each piece of evidence."""
    if found.predicted is not None:
        yield "predicted", _describe_prediction(found)
    moment = ", ".join(f"{value:.3g}" for value in found.budget)
    if found.gust is None:
        yield "worst gust", f"not searched: {found.gust_note}"
    else:
        phi, theta, psi = (_finite(value) for value in found.gust.peaks_deg)
        yield (
            "worst gust",
            f"roll {phi}, pitch {theta}, yaw {psi} deg, found in {found.gust.flights} flights over the spreads within "
            f"moments of {moment} N m, from: {found.gust.start}",
        )
    if found.proof is None:
        yield "proof", f"none: {found.proof_note}"
    elif found.proof.proven:
        if found.proof.is_whole:
            yield "proved", found.proof.claim
        else:
            yield "proved in part", f"{found.proof.verdict}: {found.proof.claim}"
    else:
        yield "not proved", found.proof.claim
    if found.failure is not None:
        yield "where it fails", found.failure.describe()


def iter_comparison(weighed: Improvement) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield name and values of both judgements."""
    found, better = both = weighed.now, weighed.better
    yield "verdict", (found.verdict.value, better.verdict.value)
    yield "Ms nominal", (_maybe(found.Ms), _maybe(better.Ms))
    yield "Ms over the spreads", (describe_spread_peak(found), describe_spread_peak(better))
    yield from _compare_margins(found, better)
    yield "predicted error [deg]", _pair([each.rmse_deg for each in both])
    yield "predicted error, by its own attitude [deg]", _pair([each.seen_rmse_deg for each in both])
    yield "predicted slew [N m/s]", _pair([each.slew for each in both])
    yield "worst gust found [deg]", _pair([None if each.gust is None else each.gust.peak_deg for each in both])
    if found.failure is not None:
        ends = describe_end(found.failure.figures), describe_end(weighed.where_now_fails)
        yield "peak where it fails now [deg]", ends
    yield from _compare_parameters(weighed)


def _compare_parameters(weighed: Improvement) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield name and values of the parameters that differ, the better ones with their limits."""
    old, new = (each.law.provenance.parameters for each in (weighed.now, weighed.better))
    limits = weighed.find_limits()
    for name in (name for name in new if name in old and new[name] != old[name]):
        limit = f": {limits[name]}" if name in limits else ""
        yield name, (f"{old[name]:.4g}", f"{new[name]:.4g}{limit}")


def _compare_margins(found: Judgement, better: Judgement) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the least margins of both, of the worst axis: nominal, then at the worst corner."""
    both = [least_margins(each) for each in (found, better)]
    texts = [None if each is None else [_margins(loop) for loop in each] for each in both]
    for column, name in enumerate(COLUMNS[3:-1], 1):  # the crossover, before them, is no margin
        first, second = ("-" if each is None else f"{each[0][column]}; {each[1][column]}" for each in texts)
        yield f"{name}, nominal; worst corner", (first, second)


def _describe_prediction(found: Judgement) -> str:
    axes = ", ".join(f"{name} {axis.rmse_deg:.3g}" for name, axis in zip(AXES, found.axes, strict=True))
    parts = [f"error {found.rmse_deg:.3g} deg ({axes}), slew {found.slew:.3g} N m/s, average over many flights"]
    if found.seen_rmse_deg is not None:
        parts.append(f"{found.seen_rmse_deg:.3g} deg by its own attitude, without the walk of the gyro's noise")
    if found.worst_rmse_deg is not None:
        parts.append(f"{found.worst_rmse_deg:.3g} deg at the worst corner")
    if found.least_rmse_deg is not None:
        parts.append(f"least possible at this Ms and slew {found.least_rmse_deg:.3g} deg")
    return "; ".join(parts)


def _margins(loop: LoopMargins) -> tuple[str, ...]:
    delay = 1e3 * loop.delay_margin
    return (
        f"{loop.crossover:.3g}",
        f"{math.degrees(loop.phase_margin):.3g}",
        _finite(loop.gain_margin),
        f"{loop.gain_reduction_margin:.3g}",
        _finite(delay),
    )


def _pair(values: list[float | None]) -> tuple[str, str]:
    first, second = map(_maybe, values)
    return first, second


def _maybe(value: float | None) -> str:
    return "-" if value is None else _finite(value)


def _finite(value: float) -> str:
    return format_margin(value if math.isfinite(value) else None)


def describe_spread_peak(found: Judgement) -> str:
    """Return the largest sensitivity over the spreads: its bound, rounded up, where it is proved."""
    peak = found.Ms_over_spreads
    return _maybe(peak) if peak is None or not found.is_proved else f"≤ {_up(peak)}"


def _up(value: float) -> str:
    """Return a proved bound, rounded up."""
    return f"{math.ceil(1e2 * value) / 1e2:g}"
