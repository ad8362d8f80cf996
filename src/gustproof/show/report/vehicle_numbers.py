"""Results of an identification as text and as a document of JSON."""

import math
from collections.abc import Callable
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from firmware_model.types import AXES
from gustproof.logs.identify.air import IdentifiedAir
from gustproof.logs.identify.identification import AxisEstimate, Interval
from gustproof.logs.identify.shown_vehicle import ShownVehicle
from gustproof.logs.read.flight_log import assumptions
from gustproof.show.report.terminal import Renderable, warning_lines


def identification_document(shown: ShownVehicle) -> dict[str, Any]:
    """Return the numbers as JSON values, with units in their keys; `None` for those that the log does not tell."""
    found, air = shown.identification, shown.air

    def by_axis(value: Any) -> dict[str, Any]:
        return {name: value(axis) for name, axis in zip(AXES, found.axes, strict=True)}

    motors = None if found.motor_gains is None else found.motor_gains.tolist()
    return {
        "source": found.source,
        "command_unit": found.command_unit.value,
        "actuator_lag_s": _interval(found.actuator_lag),
        "delay_s": _interval(found.delay),
        "lag_and_delay_s": _interval(found.lateness),
        "gain_rad_s2_per_unit": by_axis(lambda axis: _interval(axis.gain)),
        "motor_gain_rad_s2": motors
        and {name: gains if axis.gain else None for name, gains, axis in zip(AXES, motors, found.axes, strict=True)},
        "damping_per_s": by_axis(lambda axis: _interval(axis.damping)),
        "gyro_noise_rad_s_rthz": by_axis(lambda axis: axis.noise),
        "held_out_r2": by_axis(lambda axis: axis.held_out_r2),
        "disturbance": {
            "rms_rad_s2": by_axis(lambda axis: axis.disturbance_rms),
            "corner_rad_s": by_axis(lambda axis: axis.disturbance_corner),
            "dryden": None if air is None else _dryden_document(air),
        },
        "advice": {name: axis.advice for name, axis in zip(AXES, found.axes, strict=True) if axis.advice},
        "findings": list(shown.findings),
    }


def _dryden_document(air: IdentifiedAir) -> dict[str, Any]:
    return {
        "wind_speed_20ft_mps": air.wind_speed_20ft,
        "airspeed_mps": air.airspeed,
        "rms_rad_s2": dict(zip(AXES, air.sigma.tolist(), strict=True)),
        "length_m": dict(zip(AXES, air.length.tolist(), strict=True)),
    }


def _cell(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _interval(interval: Interval | None) -> dict[str, float] | None:
    return None if interval is None else {name: float(value) for name, value in interval._asdict().items()}


def number_rows(shown: ShownVehicle) -> list[tuple[str, ...]]:
    """Return quantity with unit, and its texts for roll, pitch and yaw; those of the whole vehicle have one text."""
    found, air = shown.identification, shown.air
    torque = found.command_unit.value

    def by_axis(label: str, cell: Callable[[AxisEstimate], str]) -> tuple[str, ...]:
        return (label, *map(cell, found.axes))

    rows = [
        ("actuator lag [ms]", _format_interval(found.actuator_lag, 1e3, least=0.0), "", ""),
        ("delay of the command [ms]", _format_interval(found.delay, 1e3, least=0.0), "", ""),
        ("lag and delay together [ms]", _format_interval(found.lateness, 1e3, least=0.0), "", ""),
        by_axis(f"gain [rad/s²{'' if torque == '1' else f' per {torque}'}]", lambda axis: _format_interval(axis.gain)),
    ]
    if found.motor_gains is not None:
        told = zip(found.motor_gains.tolist(), found.axes, strict=True)
        cells = ("–" if axis.gain is None else ", ".join(f"{gain:.3g}" for gain in gains) for gains, axis in told)
        rows.append(("of each motor at full thrust [rad/s²]", *cells))
    rows += [
        by_axis("damping [1/s]", lambda axis: _format_interval(axis.damping)),
        by_axis("gyro noise [rad/s/√Hz]", lambda axis: _cell(axis.noise)),
        by_axis(
            "R² of the held-out third", lambda axis: "–" if axis.held_out_r2 is None else f"{axis.held_out_r2:.3f}"
        ),
        by_axis("disturbance, rms [rad/s²]", lambda axis: _cell(axis.disturbance_rms)),
    ]
    if air is not None:
        doubt = ", in doubt" if air.doubt else ""
        rows += [
            ("as Dryden turbulence, rms [rad/s²]", *(f"{value:.3g}" for value in air.sigma)),
            ("length of its gusts [m]", *(f"{value:.3g}" for value in air.length)),
            (f"its wind at 20 ft [m/s]{doubt}", f"{air.wind_speed_20ft:.3g}", "", ""),
            (f"its airspeed [m/s]{doubt}", f"{air.airspeed:.3g}", "", ""),
        ]
    return rows


def render_identification(shown: ShownVehicle) -> Renderable:
    """Return the numbers as a table, with 95 % intervals, and findings as warnings; what is taken for granted first."""
    table = Table("95 % intervals in brackets", *AXES, title=f"Vehicle of {shown.identification.source}")
    for row in number_rows(shown):
        table.add_row(*row)
    taken = assumptions(shown.findings)
    others = [line for line in shown.findings if line not in taken]
    return Group(*map(Text, taken), table, *warning_lines(others))


def _format_interval(interval: Interval | None, scale: float = 1.0, *, least: float = -math.inf) -> str:
    """Return value and interval, of which what is below the `least` possible is left out."""
    if interval is None:
        return "–"
    ends = [max(scale * value, least) for value in interval]
    nothing = 1e-3 * (ends[-1] - ends[0])  # no digit of a smaller value is known
    low, nominal, high = (f"{value if abs(value) > nothing else 0.0:.3g}" for value in ends)
    return f"{nominal} ({low} .. {high})"
