"""Results of a design as tables, and the figure of its singular values."""

from pathlib import Path

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.report.loop_tables import format_margin, format_poles, margins_table
from gustproof.report.terminal import Renderable
from gustproof.synthesis.derive import DesignReport

_FREQUENCIES = np.geomspace(1e-3, 1e3, 600)


def render_design(report: DesignReport) -> Renderable:
    """Return levels, order, margins and controller poles of a design."""
    figures = report.to_dict()
    levels = Table("", "", title=f"Design {figures['design']}: {figures['description']}", show_header=False)
    least = figures["gamma_opt"]
    levels.add_row("least level, gamma_opt", "not solvable" if least is None else f"{least:.5f}")
    levels.add_row("level designed for, gamma", f"{figures['gamma']:.5f}")
    levels.add_row("norm achieved", f"{figures['norm']:.5f} at {format_margin(figures['norm_omega_rad_s'])} rad/s")
    levels.add_row("controller states", str(figures["order"]))
    levels.add_row("stability augmentation in the model, leak", f"{figures['leak_per_s']:g} 1/s")
    levels.add_row("exact kinematics in the law", "yes" if figures["scheduled"] else "no")
    for name, value in figures.get("step", {}).items():
        levels.add_row(f"step of the reference: {name}", format_margin(value))
    return Group(
        levels,
        margins_table("as designed, continuous", figures["continuous"]),
        margins_table(f"as flown, sampled every {figures['dt_s']:g} s, one sample of delay", figures["sampled"]),
        Text(f"controller poles [rad/s]: {format_poles(figures['poles_rad_s'])}"),
    )


def save_design_figure(report: DesignReport, path: Path) -> None:
    """Draw the singular values of a design as PNG."""
    from gustproof.report.figures import save_singular_values

    values = report.singular_values(_FREQUENCIES)
    save_singular_values(_FREQUENCIES, values, report.result.gamma, f"Design {report.design.name}", path)
