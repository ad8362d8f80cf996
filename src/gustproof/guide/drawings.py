"""Draw the pictures of the guide from flights made here: `gustproof guide --pictures DIR`."""

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import Vehicle, load_vehicle
from gustproof.law.form import load_law
from gustproof.report.figure_style import save_figure
from gustproof.report.figures import save_histories
from gustproof.simulate.direct import fly_direct
from gustproof.types import Array, Records

WORST_MOMENT = Path(str(files("gustproof.guide"))) / "pictures" / "worst-moment.toml"
"""Scenario that `gustproof worst-case hinf-d1 -o worst-moment.toml` found in 60 s, with a duration of 120 s."""
_PAPER, _OURS = "hinf-d1", "flagship"
_NAMES = {_PAPER: "the paper's law (hinf-d1)", _OURS: "ours (flagship)"}
_COLOURS = {_PAPER: "#0072b2", _OURS: "#882255"}
_LINE, _INK, _DISK = 1.4, "#333333", 0.165  # _DISK [m] radius of a drawn rotor
_CAMERA = np.array([[0.5, 0.866, 0.0], [0.25, -0.145, -0.957]])
"""Rows: right and up of the drawing, in north, east, down; seen from the south-east and a little above."""


def draw_pictures(folder: Path) -> list[Path]:
    """Draw all pictures of the guide into a folder, which is made, and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    vehicle = load_vehicle("paper")
    turned = folder / "turned-over.png"
    draw_turned_over(fly_both(load_scenario(WORST_MOMENT), vehicle), vehicle, turned)
    drawn = [turned]
    for name in ("gust-roll", "coning"):
        drawn.append(folder / f"{name}.png")
        save_histories("euler-angles", fly_both(load_scenario(name), vehicle), name, drawn[-1])
    for file in drawn:
        _shrink(file)
    return drawn


def _shrink(file: Path) -> None:
    """Store a picture with 64 colours, a third of the bytes."""
    with Image.open(file) as picture:
        small = picture.convert("RGB").quantize(64)
    small.save(file, optimize=True)


def fly_both(scenario: Scenario, vehicle: Vehicle) -> dict[str, Records]:
    """Return the flights of the paper's law and of ours through the same scenario."""
    return {law: fly_direct(scenario, load_law(law), vehicle=vehicle, seed=1) for law in _NAMES}


def tilt_deg(records: Records) -> Array:
    """Return the angles (n,) [deg] between the vehicle's vertical axis and the true one; 180 is upside down."""
    _, x, y, _ = records["q_NB"].T
    return np.asarray(np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))))


def draw_turned_over(flights: dict[str, Records], vehicle: Vehicle, path: Path) -> None:
    """Draw the tilt of two flights over time, and both vehicles at the moment when the first is tilted most."""
    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    whole = figure.subplot_mosaic([["tilt", _PAPER, _OURS]], width_ratios=[2.0, 1.0, 1.0])
    sample = int(np.argmax(tilt_deg(flights[_PAPER])))
    for law, records in flights.items():
        time, tilt = records["time_us"] * 1e-6, tilt_deg(records)
        whole["tilt"].plot(time, tilt, color=_COLOURS[law], linewidth=_LINE)
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
