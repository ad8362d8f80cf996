"""A log's flight in words, in rows of tables, and as a document of JSON."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from firmware_model.types import AXES
from gustproof.logs.identify.stretches import sample_time
from gustproof.logs.read.assemble import SIGNALS
from gustproof.logs.read.flight_log import FlightLog, assumptions
from gustproof.show.report.judgement import title
from gustproof.show.report.terminal import Renderable, warning_lines
from gustproof.show.report.vehicle_numbers import identification_document, number_rows
from gustproof.studies.logged_flight import NO_MASS, LoggedFlight, contradiction
from gustproof.studies.rate.filter_advice import QUIET, FilterChoice, best_choice

_RAW_CURES = {
    "px4": "log sensor_combined or the raw gyro (SDLOG_PROFILE 17)",
    "ardupilot": "log it before its filters (INS_RAW_LOG_OPT 1)",
    "betaflight": "log the unfiltered gyro (gyroUnfilt)",
}


def summary(flight: LoggedFlight, *, has_verdict: bool = False) -> Iterator[str]:
    """Yield what flew, and what is said of it, the most important first; no verdict if it stands elsewhere."""
    log = flight.log
    told = flight.no_judgement.removeprefix(f"{flight.log.source}: ")
    if not has_verdict:
        yield f"verdict: {title(flight.judgement)}" if flight.judgement else f"no verdict: {told}"
        yield from (f"- {reason}" for reason in (flight.judgement.reasons if flight.judgement else ()))
    length, parameters = log.gyro.time[-1] - log.gyro.time[0], len(log.parameters)
    yield f"flight: {log.system}, {length:.0f} s of log, {log.aloft:.0f} s in the air, parameters: {parameters}"
    yield from assumptions(log.findings)
    if flight.judgement is not None:
        yield f"judged on the vehicle that this log shows; {NO_MASS}"
        if doubt := contradiction(flight.log, flight.judgement):
            yield doubt
        if (command := flight.judgement.vehicle.command) and command.unmeasured:
            yield f"not measured, a guess from the other axes: {', '.join(command.unmeasured)}"


def signal_rows(log: FlightLog) -> Iterator[tuple[str, ...]]:
    """Yield name, rate [Hz] and number of samples of each signal."""
    for name in SIGNALS:
        signal = getattr(log, name)
        filtered = "" if name != "gyro" else ", before filters" if log.is_gyro_raw else ", filtered or not known"
        if signal is None:
            yield name.replace("_", " "), "–", "none"
        else:
            yield f"{name.replace('_', ' ')}{filtered}", f"{1.0 / sample_time(signal):.0f}", f"{len(signal.time)}"


def describe_vibration(flight: LoggedFlight) -> Iterator[str]:
    """Yield vibration, its lines, and what to do about the filters."""
    spectrum = flight.spectrum
    if spectrum is None:
        yield "the log is too short in the air, or too slow, to show vibration"
        return
    levels = ", ".join(f"{axis} {value:.2g}" for axis, value in zip(AXES, spectrum.vibration, strict=True))
    yield f"rms above 15 Hz and up to {spectrum.hertz[-1]:.0f} Hz: {levels} rad/s"
    yield from (f"line: {line.describe()}" for line in spectrum.lines)
    if not spectrum.lines:
        yield "no line stands out"
    if not spectrum.is_raw:
        cure = _RAW_CURES.get(flight.log.system, "log it before its filters")
        yield f"filters are not weighed: the gyro may be logged behind them; {cure}"
    elif not flight.filters:
        yield "filters are not weighed: there is no judgement"
    elif (best := best_choice(flight.filters)) is not None:
        now, set_to = flight.filters[0], ", ".join(f"{name} {value:g}" for name, value in best.changes.items())
        why = "less vibration" if max(now.shaking) > QUIET else "vibration is small, and filters may be opened"
        yield (
            f"better filters at the same gains, {why}: {set_to}. Vibration in the command {_percent(now)} to "
            f"{_percent(best)} of full scale, Ms {_axes(now.Ms)} to {_axes(best.Ms)}, "
            f"delay margin {_axes(now.delay_ms)} to {_axes(best.delay_ms)} ms"
        )
    else:
        yield "no filter that was tried is better at the same gains"


def filter_rows(choices: Sequence[FilterChoice]) -> list[tuple[str, ...]]:
    """Return the head and the rows of the filters' table; nothing without any."""
    if not choices:
        return []
    rows = [(each.label, _percent(each), _axes(each.Ms), _axes(each.delay_ms)) for each in choices]
    heads = ("vibration in the command, of full scale", "Ms of roll, pitch, yaw", "delay margin [ms]")
    return [("filters, at the gains that flew", *heads), *rows]


def render_flight(flight: LoggedFlight) -> Renderable:
    """Return the log's report for a terminal."""
    head, *body = filter_rows(flight.filters) or [()]
    parts: list[Renderable] = [Text(line) for line in summary(flight)]
    parts += [Text(line) for line in (*(each.describe() for each in flight.steps), *flight.not_told)]
    parts += [Text(f"vibration: {line}") for line in describe_vibration(flight)]
    for columns, rows in ((head, body), _vehicle_table(flight)):
        if columns:
            table = Table(*columns)
            for row in rows:
                table.add_row(*row)
            parts.append(table)
    return Group(*parts, *warning_lines(doubts(flight)))


def _vehicle_table(flight: LoggedFlight) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
    if flight.shown is None:
        return (), ()
    return ("95 % intervals in brackets", *AXES), number_rows(flight.shown)


def doubts(flight: LoggedFlight) -> tuple[str, ...]:
    """Return the doubts on log and vehicle, a line each; what `no_judgement` has said is not said again."""
    told = (flight.no_judgement, *assumptions(flight.log.findings))
    return tuple(
        line
        for line in _findings(flight)
        if line not in told and line.removeprefix(f"{flight.log.source}: ") not in told[0]
    )


def _findings(flight: LoggedFlight) -> tuple[str, ...]:
    return (*flight.log.findings, flight.no_vehicle) if flight.shown is None else flight.shown.findings


def flight_document(flight: LoggedFlight) -> dict[str, Any]:
    """Return the numbers as JSON values, with units in their keys; `None` for those that the log does not tell."""
    spectrum, best = flight.spectrum, best_choice(flight.filters)
    return {
        "source": flight.log.source,
        "system": flight.log.system,
        "airborne_s": [list(each) for each in flight.log.airborne or ()],
        "step_responses": [
            {
                "loop": each.loop.value,
                "axis": AXES[each.axis],
                "half_s": each.reaches(0.5),
                "ninety_percent_s": each.reaches(0.9),
                "peak": each.peak,
                "peak_high": each.peak_high,
                "coherent_rad_s": each.band,
            }
            for each in flight.steps
        ],
        "not_told": list(flight.not_told),
        "vibration": None
        if spectrum is None
        else {
            "rms_rad_s": dict(zip(AXES, np.asarray(spectrum.vibration).tolist(), strict=True)),
            "is_raw": spectrum.is_raw,
            "lines": [
                {"hertz": line.hertz, "height_db": line.height_db, "share": line.share, "moves_hertz": line.moves}
                for line in spectrum.lines
            ],
        },
        "filters": [
            {
                "label": each.label,
                "parameters": dict(each.changes),
                "vibration_of_full_scale": each.shaking,
                "Ms": list(each.Ms),
                "delay_margin_ms": list(each.delay_ms),
                "best": each is best,
            }
            for each in flight.filters
        ],
        "vehicle": None if flight.shown is None else identification_document(flight.shown),
        "no_vehicle": flight.no_vehicle,
        "judgement": None if flight.judgement is None else flight.judgement.to_dict(),
        "no_judgement": flight.no_judgement,
        "findings": list(_findings(flight)),
    }


def _percent(choice: FilterChoice) -> str:
    return f"{100.0 * max(choice.shaking):.2g} %"


def _axes(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.3g}" for value in values) if values else "unstable"
