"""Figures are drawn, of the flights and the objects that are given."""

import colorsys
import csv
import re
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.recording.journal import RECORD
from gustproof.airframe.rotational import Envelope, paper_rotation
from gustproof.design.derive import WeightedTransfer
from gustproof.design.designs import design_problem, load_design
from gustproof.show.report import diagrams, figures
from gustproof.show.report.figure_style import FigureStyle, figures_as, save_figure
from gustproof.show.report.laid_out import LaidOutFigure


def flight(amplitude: float = 0.1, n: int = 250):
    records = np.zeros(n, dtype=RECORD)
    records["time_us"] = np.arange(n) * 4000
    angle = amplitude * np.sin(np.arange(n) / 20.0)
    records["q_NB"][:, 0], records["q_NB"][:, 1] = np.cos(angle / 2), np.sin(angle / 2)
    records["torque_command_B"][:, 2] = angle
    records["omega_B"][:, 0] = 2.0 * angle
    return records


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_euler_angles_are_drawn_in_degrees_against_seconds(drawn, tmp_path):
    figures.save_histories("euler-angles", {"hinf-d1": flight()}, "paper", tmp_path / "x.png")
    line = drawn[0].axes[0].lines[0]
    assert np.max(line.get_ydata()) == pytest.approx(np.degrees(0.1), rel=1e-3)
    assert line.get_xdata()[-1] == pytest.approx(249 * 0.004)
    assert all("[deg]" in axes.get_ylabel() for axes in drawn[0].axes)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_a_figure_laid_out_first_has_the_bytes_of_matplotlibs(suffix, tmp_path):
    for kind, name in ((LaidOutFigure, "ours"), (partial(Figure, layout="constrained"), "matplotlib")):
        figure = kind(figsize=(3.0, 3.0))
        for axes in figure.subplots(2, 1):
            axes.semilogy(np.arange(5), 10.0 ** np.arange(5), label="a curve")
            axes.legend()
        with figures_as(FigureStyle.SCREEN):
            save_figure(figure, tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"ours{suffix}").read_bytes() == (tmp_path / f"matplotlib{suffix}").read_bytes()


def test_a_law_has_one_colour_in_every_figure_and_no_two_laws_share_one(drawn, tmp_path):
    flights = {"pid-default": flight(), "hinf-d1": flight(0.2), "pid-fair": flight(0.3)}
    figures.save_histories("euler-angles", flights, "", tmp_path / "x.png")
    figures.save_histories("torques", flights, "", tmp_path / "x.png")
    colours = [{line.get_label(): line.get_color() for line in figure.axes[0].lines} for figure in drawn]
    assert colours[0] == colours[1]
    assert len(set(colours[0].values())) == len(flights)


def test_scheduling_shows_seven_parameters_each_between_its_bounds(drawn, tmp_path):
    figures.save_scheduling(flight(), "hinf-d1", tmp_path / "x.png")
    panels = [axes for axes in drawn[0].axes if "rho" in axes.get_ylabel()]
    bounds = sorted(tuple(float(line.get_ydata()[0]) for line in axes.lines[1:]) for axes in panels)
    assert bounds == sorted([(-1.0, 1.0), (0.0, 1.0)] * 2 + [(-1.5, 1.5)] * 3)


def test_singular_values_that_are_rounding_noise_are_not_drawn(drawn, tmp_path):
    frequency = np.geomspace(1e-3, 1e3, 50)
    low = 1.0 / (1.0 + frequency)
    values = {"w to z": np.stack([low, 1e-3 * low, 1e-19 * low], axis=1), "S": np.ones((50, 1))}
    figures.save_singular_values(frequency, values, 1.0, "x", tmp_path / "x.png")
    weighted, S = drawn[0].axes
    assert len(weighted.lines) == 2 + 1  # and the level
    assert weighted.get_ylim()[0] == -80.0
    assert [text.get_text() for text in weighted.get_legend().get_texts()] == ["w to z", "γ = 1"]
    assert [text.get_text() for text in S.get_legend().get_texts()] == ["S, peak 1.00", "0 dB"]


def test_transfers_are_drawn_below_the_bounds_of_their_weights_but_in_a_paper(drawn, tmp_path):
    frequency = np.geomspace(1e-3, 1e3, 50)
    gains = np.outer(1.0 / (1.0 + frequency), np.ones(3))
    transfer = WeightedTransfer("moment", "command", ("N m", "N m"), gains, 2.0 * np.ones((50, 3)))
    values = {"w to z": gains, "S": np.ones((50, 1))}
    for style in FigureStyle:
        with figures_as(style):
            figures.save_singular_values(frequency, values, 1.0, "x", tmp_path / "x.png", [transfer])
    screen, paper = drawn
    assert (len(screen.axes), len(paper.axes)) == (4, 2)
    axes = screen.axes[2]
    assert axes.get_title() == "moment to command"
    assert [line.get_linestyle() for line in axes.lines] == 3 * ["-", "--"]
    assert np.min(axes.lines[1].get_ydata() - axes.lines[0].get_ydata()) == pytest.approx(6.02, abs=0.01)
    assert not screen.axes[3].axison


def test_more_flights_than_an_eye_can_tell_apart_are_drawn_as_rms_of_each_second(drawn, tmp_path):
    figures.save_histories("body-rates", {f"law {i}": flight(0.1 * i) for i in range(1, 11)}, "", tmp_path / "x.png")
    line = next(line for line in drawn[0].axes[0].lines if line.get_label() == "law 3")
    assert line.get_xdata().tolist() == [0.5]  # one second
    expected = np.sqrt(np.mean(flight(0.3)["omega_B"][:, 0] ** 2))
    assert line.get_ydata()[0] == pytest.approx(expected)
    assert len(drawn[0].axes[0].lines) == 10


def test_the_angles_of_the_least_rms_stand_beside_those_of_all_as_flown(drawn, tmp_path):
    flights = {f"law-of-a-long-name-{i}": flight(0.1 / i) for i in range(1, 11)}
    figures.save_histories("euler-angles", flights, "", tmp_path / "x.png")
    figure = drawn[0]
    everyone, least = figure.axes[:2]
    assert (len(everyone.lines), everyone.get_yscale(), least.get_yscale()) == (10, "log", "linear")
    assert {line.get_label() for line in least.lines} == {f"law-of-a-long-name-{i}" for i in range(7, 11)}
    assert np.max(least.lines[0].get_ydata()) == pytest.approx(np.degrees(0.1 / 7), rel=1e-3)
    assert everyone.yaxis.get_major_formatter()(0.1) == "0.1"
    assert least.get_xlim() == (0.0, pytest.approx(1.0))  # with the last tick


def test_a_legend_is_no_wider_than_its_figure(drawn, tmp_path):
    flights = {f"flagship-robust-{i}": flight() for i in range(10)}
    figures.save_histories("torques", flights, "", tmp_path / "x.png")
    assert drawn[0].legends[0].get_window_extent().width < drawn[0].bbox.width


def test_a_figure_for_a_paper_is_a_column_wide_with_its_numbers_beside(drawn, tmp_path):
    with figures_as(FigureStyle.PAPER, data=True, suffix=".svg"):
        figures.save_histories("euler-angles", {"hinf-d1": flight()}, "paper", tmp_path / "x.png")
    assert drawn[0].get_figwidth() == 3.5
    assert drawn[0].get_suptitle() == ""
    assert drawn[0].axes[0].yaxis.label.get_fontfamily() == ["serif"]
    with (tmp_path / "x.csv").open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["panel"] == "1"]
    assert [float(row["x"]) for row in rows] == pytest.approx([i * 0.004 for i in range(250)])
    assert {(row["curve"], row["y_label"]) for row in rows} == {("hinf-d1", "roll φ [deg]")}
    assert float(rows[31]["y"]) == pytest.approx(np.degrees(0.1 * np.sin(31 / 20.0)))


def test_pgf_is_refused_before_anything_is_flown_where_no_tex_measures_text(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigError, match=r"figures as \.pgf need a TeX installation"):
        figures.save_moments(flight(), tmp_path / "x.pgf")
    with pytest.raises(ConfigError, match="TeX"), figures_as(FigureStyle.PAPER, suffix=".pgf"):
        pass
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "begin"),
    [pytest.param(".pdf", b"%PDF", marks=pytest.mark.slow), (".svg", b"<?xml"), (".png", b"\x89PNG")],
)
def test_the_suffix_chooses_the_format_and_equal_flights_give_equal_bytes(suffix, begin, tmp_path):
    for name in ("a", "b"):
        figures.save_moments(flight(), tmp_path / f"{name}{suffix}")
    a, b = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("a", "b"))
    assert a.startswith(begin)
    assert a == b


@pytest.mark.parametrize("design", ["D1", "reference", "R1"])
def test_the_interconnection_names_every_block_and_every_exogenous_signal(design, drawn, tmp_path):
    problem = design_problem(load_design(design), load_vehicle("paper"))
    diagrams.save_interconnection(problem, "x", tmp_path / "x.png")
    labels = {signal.name: signal.label for signal in problem.signals}
    expected = {"$K$", *(block.label for block in problem.blocks), *(labels[s] for s in (*problem.w, *problem.z))}
    assert expected <= set(texts(drawn[0]))


def test_the_lft_names_its_three_boxes_and_the_width_of_each_signal(drawn, tmp_path):
    vehicle = load_vehicle("paper")
    dynamics = paper_rotation(vehicle.inertia_B, Envelope(angle=0.3, rate=0.5))
    diagrams.save_lft(design_problem(load_design("D1"), vehicle), dynamics, "x", tmp_path / "x.png")
    written = " ".join(texts(drawn[0]))
    for k, repeats in zip(range(1, 8), ("$I_{2}$", "$I_{2}$", "", "", "$I_{2}$", "$I_{2}$", "$I_{2}$"), strict=True):
        assert rf"$\rho_{k}${repeats}" in written
    assert written.count("$I_{2}$") == 5  # twelve repetitions in all
    for label in ("$P$", "$K$", "$w_d$ (3)", "$z_u$ (3)", "$u$ (3)"):
        assert label in written


@pytest.mark.parametrize("design", ["D1", "reference", "R1", "aided"])
def test_no_two_nodes_of_a_diagram_overlap_and_wires_go_right(design):
    problem = design_problem(load_design(design), load_vehicle("paper"))
    boxes, sums = diagrams.place_nodes(problem)
    shown = [*boxes.values(), *sums]
    for i, a in enumerate(shown):
        assert all(abs(a[0] - b[0]) > 1.0 or abs(a[1] - b[1]) > 0.75 for b in shown[:i])
    forward = [wire.points for wire in diagrams.route_wires(problem) if wire.signal not in problem.y]
    assert len(forward) > len(problem.blocks)
    assert all(a[0] <= b[0] for points in forward for a, b in pairwise(points))


@pytest.mark.parametrize("design", ["D1", "reference", "R1", "aided"])
def test_every_reader_of_a_signal_has_a_wire_and_none_passes_through_a_box(design):
    problem = design_problem(load_design(design), load_vehicle("paper"))
    boxes, _ = diagrams.place_nodes(problem)
    wires = diagrams.route_wires(problem)
    readers = [*(name for block in problem.blocks for name in block.inputs), *problem.y, *problem.z]
    readers += [name for junction in problem.sums for _, name in junction.terms]
    assert sorted(wire.signal for wire in wires) == sorted(readers)
    for wire in wires:
        for (x0, y0), (x1, y1) in pairwise(wire.points):
            for t in np.linspace(0.01, 0.99, 99):
                x, y = x0 + t * (x1 - x0), y0 + t * (y1 - y0)
                assert not any(abs(x - a) < 0.7 and abs(y - b) < 0.34 for a, b in boxes.values())


def test_a_diagram_of_anything_else_is_refused():
    problem = design_problem(load_design("D1"), load_vehicle("paper"))
    blocks = tuple(replace(block, name="motor") if block.name == "actuators" else block for block in problem.blocks)
    with pytest.raises(ValueError, match="'motor' has no place"):
        diagrams.place_nodes(replace(problem, blocks=blocks))


def hues(colours: Iterable[str]) -> list[float]:
    """Return the hues [deg] of the colours that are not grey."""
    parts = [tuple(int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)) for colour in colours]
    return [360.0 * colorsys.rgb_to_hls(*rgb)[0] for rgb in parts if max(rgb) - min(rgb) > 0.15]


def test_colours_of_two_laws_are_never_of_one_hue():
    styles = Path(figures.__file__).with_name("assets") / "page.css"
    pages = [re.findall(r"--c\d: (#\w{6})", line) for line in styles.read_text().splitlines() if "--c0" in line]
    assert [len(colours) for colours in pages] == [7, 7]  # light and dark
    for colours in (*pages, [*figures._COLOURS.values(), figures._DEFAULT_COLOUR]):
        found = sorted(hues(colours))
        assert len(found) >= 6
        gaps = [b - a for a, b in pairwise([*found, found[0] + 360.0])]
        assert min(gaps) > 24.0


def test_laws_of_the_user_take_no_shipped_law_s_colour():
    found = figures.law_colours(["mine", "flagship", "other"])
    assert list(found) == ["mine", "flagship", "other"]
    assert len(set(found.values())) == 3
    assert found["flagship"] == figures._COLOURS["flagship"]
