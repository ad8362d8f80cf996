"""Draw the pictures of the guide from flights made here: `python -P -m gustproof.guide.drawings DIR`."""

import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.config.whole_file import whole_file
from firmware_model.numerics.rotations import euler_angles
from firmware_model.types import AXES
from gustproof.airframe.covariance import axis_models
from gustproof.airframe.predict import predict
from gustproof.airframe.tradeoff import linear_laws
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law
from gustproof.prove.boundedness import certify_boundedness
from gustproof.show.report.figure_style import save_figure
from gustproof.show.report.figures import law_colours, save_histories
from gustproof.show.report.laid_out import LaidOutFigure
from gustproof.types import Array, Records

WORST_MOMENT = Path(str(files("gustproof.guide"))) / "pictures" / "worst-moment.toml"
"""Scenario that `gustproof worst-case hinf-d1 -o worst-moment.toml` found in 60 s, with a duration of 120 s."""
_PAPER, _OURS, _FAIR = "hinf-d1", "flagship", "pid-fair"
_NAMES = {_PAPER: "the paper's law (hinf-d1)", _OURS: "ours (flagship)"}
_COLOURS = law_colours((_PAPER, _OURS, _FAIR))
_OWN_LOOPS = "#888888"  # of an autopilot, which are no law
PICTURES = ("turned-over", "gust", "gust-roll", "log", "tuned", "box", "cases", "autopilots", "coning")
"""Names of the pictures, in the order in which they are drawn."""
OWN_AND_INSIDE = r"^\| (PX4|ArduPilot), (own loops|`flagship` inside)[^|]* \| (\.\d+) \| (\.\d+) \| ([\d.]+) \|"
"""Rows of `autopilots.md` at equal slew and margins: autopilot, loops, both errors [deg] and slew [N*m/s]."""
_AXIS_COLOURS = ("#0072b2", "#d55e00", "#009e73")
_PEAK_MS, _SLEWS = 1.36, (5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0)  # [N*m/s]
_PEAK_DEG, _BUDGET_NM, _MINUTE_S, _CASES = 1.0, (0.65, 0.65, 0.3), 60.0, 40
_TINTS, _LABEL_S = 32, 96.0
_LINE, _INK, _DISK = 1.4, "#333333", 0.165  # _DISK [m] radius of a drawn rotor
_CAMERA = np.array([[0.5, 0.866, 0.0], [0.25, -0.145, -0.957]])
"""Rows: right and up of the drawing, in north, east, down; seen from the south-east and a little above."""


def draw_pictures(folder: Path) -> list[Path]:
    """Draw all pictures of the guide into a folder, which is made, and return the files."""
    folder.mkdir(exist_ok=True)
    vehicle = load_vehicle("paper")
    worst = fly_both(load_scenario(WORST_MOMENT), vehicle)
    gust, coning = (fly_both(load_scenario(name), vehicle) for name in ("gust-roll", "coning"))
    drawn = [folder / f"{name}.png" for name in PICTURES]
    turned, gust_seen, gust_roll, log, tuned, box, cases, autopilots, coned = drawn
    draw_turned_over(worst, vehicle, turned)
    _draw_gust(gust[_OURS], gust_seen)
    _draw_gust_roll(gust, gust_roll)
    _draw_log(vehicle, log)
    _draw_tuning(vehicle, tuned)
    _draw_box(worst[_OURS], box)
    _draw_cases(vehicle, cases)
    _draw_autopilots(autopilots)
    save_histories("euler-angles", coning, "coning", coned)
    for file in drawn:
        _shrink(file)
    return drawn


def _shrink(file: Path) -> None:
    """Store a picture with few colours, a third of the bytes."""
    with Image.open(file) as picture:
        small = picture.convert("RGB").quantize(_TINTS, Image.Quantize.FASTOCTREE)
    drawn = BytesIO()
    small.save(drawn, format="png", optimize=True)
    with whole_file(file, overwrite=True) as shrunk:
        shrunk.write(drawn.getbuffer())


def fly_both(scenario: Scenario, vehicle: Vehicle) -> dict[str, Records]:
    """Return the flights of the paper's law and of ours through the same scenario."""
    return {law: fly_direct(scenario, load_law(law), vehicle=vehicle, seed=1) for law in _NAMES}


def tilt_deg(records: Records) -> Array:
    """Return the angles (n,) [deg] between the vehicle's vertical axis and the true one; 180 is upside down."""
    _, x, y, _ = records["q_NB"].T
    return np.asarray(np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))))


def _new_panels(columns: int, **shared: Any) -> tuple[Figure, list[Axes]]:
    figure = LaidOutFigure(figsize=(9.0, 3.0))
    axes = [*figure.subplots(1, columns, squeeze=False, **shared).ravel()]
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _draw_gust(records: Records, path: Path) -> None:
    """Draw a gust, and the roll, torque and limit of the vehicle in it."""
    figure, (wind, roll, torque) = _new_panels(3)
    time = records["time_us"] * 1e-6
    for axes, values, name in (
        (wind, records["gust_B"][:, 1], "gust from the left [m/s]"),
        (roll, np.degrees(euler_angles(records["q_NB"]))[:, 0], "roll [deg]"),
        (torque, records["torque_command_B"][:, 0], "roll torque [N m]"),
    ):
        axes.plot(time, values, color=_COLOURS[_OURS], linewidth=_LINE)
        axes.set(xlabel="time [s]", ylabel=name, xlim=(0.0, time[-1]))
    _mark_limit(roll, _PEAK_DEG, "allowed")
    save_figure(figure, path)


def _mark_limit(axes: Axes, limit: float, words: str) -> None:
    for height in (-limit, limit):
        axes.axhline(height, color=_INK, linewidth=0.8, linestyle="--")
    axes.text(axes.get_xlim()[1], limit, words, color=_INK, fontsize=9, ha="right", va="bottom")


def _draw_gust_roll(flights: dict[str, Records], path: Path) -> None:
    """Draw the roll of both laws in the same gust."""
    figure, (axes,) = _new_panels(1)
    for law, records in flights.items():
        roll = np.degrees(euler_angles(records["q_NB"]))[:, 0]
        axes.plot(records["time_us"] * 1e-6, roll, color=_COLOURS[law], linewidth=_LINE, label=_NAMES[law])
    axes.set(xlabel="time [s]", ylabel="roll [deg]", xlim=(0.0, 6.0))
    _mark_limit(axes, _PEAK_DEG, "allowed")
    axes.legend(frameon=False)
    save_figure(figure, path)


def _draw_log(vehicle: Vehicle, path: Path) -> None:
    """Draw the torques and rates of the flight that a vehicle is identified from."""
    records = fly_direct(load_scenario("doublets"), load_law(_OURS), vehicle=vehicle, seed=1)
    figure, (torque, rate) = _new_panels(2, sharex=True)
    for axis, (name, colour) in enumerate(zip(AXES, _AXIS_COLOURS, strict=True)):
        for axes, values in ((torque, records["torque_command_B"]), (rate, records["gyro_B"])):
            axes.plot(records["time_us"] * 1e-6, values[:, axis], color=colour, linewidth=0.7, label=name)
    torque.set(xlabel="time [s]", ylabel="commanded torque [N m]")
    rate.set(xlabel="time [s]", ylabel="gyro [rad/s]")
    rate.legend(frameon=False, ncols=3)
    save_figure(figure, path)


def _draw_tuning(vehicle: Vehicle, path: Path) -> None:
    """Draw the least error of linear laws over the torque slew, and two shipped laws."""
    scenario = load_scenario("paper-turbulence")
    linear = linear_laws(axis_models(vehicle, scenario))
    figure, (axes,) = _new_panels(1)
    points = [linear.minimize_error(_PEAK_MS, slew) for slew in _SLEWS]
    errors = [np.degrees(point.rmse) for point in points]
    axes.plot(_SLEWS, errors, color=_INK, marker=".", label=f"least possible at Ms {_PEAK_MS:g}")
    for law in (_FAIR, _OURS):
        found = predict(load_law(law), vehicle, scenario)
        if found is not None:
            axes.plot(found.slew, np.degrees(found.rmse), "o", color=_COLOURS[law], label=law)
    axes.set(xlabel="torque slew [N m/s]", ylabel="RMSE, three axes [deg]", xlim=(0.0, None), ylim=(0.06, None))
    axes.legend(frameon=False)
    save_figure(figure, path)


def _draw_box(records: Records, path: Path) -> None:
    """Draw the attitude in the worst moment found within the box that is proved for a minute of any moment."""
    truth = certify_boundedness(_OURS, "paper", moment=_BUDGET_NM, horizon=_MINUTE_S).truth_deg or ()
    bounds = [bound for bound in truth if bound is not None]
    figure, panels = _new_panels(3)
    kept = records[records["time_us"] <= _MINUTE_S * 1e6]
    angles = np.degrees(euler_angles(kept["q_NB"]))
    for axis, (axes, name, bound) in enumerate(zip(panels, AXES, bounds, strict=True)):
        axes.plot(kept["time_us"] * 1e-6, angles[:, axis], color=_COLOURS[_OURS], linewidth=0.8)
        axes.set(xlabel="time [s]", ylabel=f"{name} [deg]", xlim=(0.0, _MINUTE_S), ylim=(-1.25 * bound, 1.25 * bound))
        _mark_limit(axes, bound, "proved")
    save_figure(figure, path)


def _draw_cases(vehicle: Vehicle, path: Path) -> None:
    """Draw the peak errors of two laws in the same gusts, weak to strong."""
    scenario, law_of = load_scenario("gust-roll"), {name: load_law(name) for name in (_FAIR, _OURS)}
    scales = np.linspace(0.5, 1.5, _CASES)
    figure, (axes,) = _new_panels(1)
    for name in (_FAIR, _OURS):
        peaks = [
            tilt_deg(fly_direct(replace(scenario, gust_scale=scale), law_of[name], vehicle=vehicle, seed=seed)).max()
            for seed, scale in enumerate(scales.tolist(), 1)
        ]
        axes.plot(scales, peaks, "o", markersize=4.0, color=_COLOURS[name], label=name)
    axes.set(xlabel="strength of the gust [-]", ylabel="largest tilt [deg]", ylim=(0.0, None))
    axes.legend(frameon=False)
    save_figure(figure, path)


def _draw_autopilots(path: Path) -> None:
    """Draw the errors of real autopilots from the table of their page."""
    text = (files("gustproof.guide") / "autopilots.md").read_text(encoding="utf-8").partition("## Their loops")[0]
    rows = re.findall(OWN_AND_INSIDE, text, re.M)
    figure, panels = _new_panels(2, sharey=True)
    labels = [f"{name}, {which.replace('`', '')}" for name, which, *_ in rows]
    for axes, column, name, digits in (
        (panels[0], 2, "RMSE [deg]", "%.3f"),
        (panels[1], 4, "torque slew [N m/s]", "%.1f"),
    ):
        values = [float(row[column]) for row in rows]
        bars = axes.barh(labels, values, color=[_COLOURS[_OURS] if "inside" in row[1] else _OWN_LOOPS for row in rows])
        axes.bar_label(bars, fmt=digits, padding=3, fontsize=9)
        axes.set_xlabel(name)
        axes.margins(x=0.12)
    panels[0].invert_yaxis()
    save_figure(figure, path)


def draw_turned_over(flights: dict[str, Records], vehicle: Vehicle, path: Path) -> None:
    """Draw the tilt of two flights over time, and both vehicles at the moment when the first is tilted most."""
    figure = LaidOutFigure(figsize=(9.0, 3.0))
    whole = figure.subplot_mosaic([["tilt", _PAPER, _OURS]], width_ratios=[2.0, 1.0, 1.0])
    sample = int(np.argmax(tilt_deg(flights[_PAPER])))
    for law, records in flights.items():
        time, tilt = records["time_us"] * 1e-6, tilt_deg(records)
        whole["tilt"].plot(time, tilt, color=_COLOURS[law], linewidth=_LINE)
        height = float(np.interp(_LABEL_S, time, tilt))
        whole["tilt"].text(_LABEL_S, height + 6.0, _NAMES[law], color=_COLOURS[law], fontsize=9, ha="right")
        _draw_vehicle(whole[law], vehicle, records["q_NB"][sample], _COLOURS[law])
        whole[law].set_title(f"{_NAMES[law]}\n{tilt[sample]:.0f}° after {time[sample]:.0f} s", fontsize=10)
    axes = whole["tilt"]
    for height, words in ((90.0, "on its side"), (180.0, "upside down")):
        axes.axhline(height, color=_INK, linewidth=0.8, linestyle="--")
        axes.text(2.0, height - 2.0, words, color=_INK, fontsize=9, verticalalignment="top")
    axes.set(xlabel="time [s]", ylabel="tilt [deg]", ylim=(0.0, 182.0), xlim=(0.0, float(time[-1])))
    axes.set_yticks(range(0, 181, 45))
    axes.set_title("worst moment found within the paper's budget", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path)


def _draw_vehicle(axes: Axes, vehicle: Vehicle, q_NB: Array, colour: str) -> None:
    """Draw arms, rotor disks and a mast on top at an attitude."""
    R = _rotation(q_NB)
    for outline, width in _outlines(vehicle):
        x, y = _CAMERA @ R @ outline.T
        axes.plot(x, y, color=colour, linewidth=width, solid_capstyle="round")
    axes.set_aspect("equal")
    axes.set(xlim=(-0.7, 0.7), ylim=(-0.55, 0.55))
    axes.axis("off")


def _outlines(vehicle: Vehicle) -> Iterator[tuple[Array, float]]:
    """Yield the lines (n, 3) [m] B of a vehicle, with their widths."""
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    circle = _DISK * np.column_stack((np.cos(turn), np.sin(turn), np.zeros_like(turn)))
    for hub in np.array(vehicle.rotors.position_B):
        yield np.array([np.zeros(3), hub]), 3.0
        yield hub + circle, _LINE
    yield np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.35]]), 2.0


def _rotation(q_NB: Array) -> Array:
    """Return the rotation matrix (3, 3) from B to N."""
    w, x, y, z = q_NB
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


if __name__ == "__main__":
    draw_pictures(Path(sys.argv[1]))
