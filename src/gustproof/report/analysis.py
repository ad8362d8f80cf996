"""Analysis of a law as tables and text."""

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.analysis.analyse import Analysis, pole_pairs
from gustproof.report.loop_tables import format_poles, margins_table
from gustproof.report.terminal import Renderable, figures_table
from gustproof.synthesis.derive import margins_to_dict


def render_analysis(analysis: Analysis) -> Renderable:
    """Return the analysis as tables and text."""
    law = analysis.law
    facts = Table("", "", title=f"Law '{law.name}': {law.provenance.design}", show_header=False)
    facts.add_row("states", str(law.order))
    facts.add_row("sample time", f"{law.dt:g} s")
    facts.add_row("commands", law.output.value)
    facts.add_row("exact kinematics in its attitude estimate", "yes" if law.is_scheduled else "no")
    parts: list[Renderable] = [facts]
    if analysis.hover.margins is not None:
        parts.append(margins_table("at hover, sampled and delayed", margins_to_dict(analysis.hover.margins)))
    parts.append(Text(f"poles of the law [rad/s]: {format_poles(pole_pairs(analysis.hover.law_poles))}"))
    if len(analysis.hover.loop_poles):
        parts.append(Text(f"poles of the loop [rad/s]: {format_poles(pole_pairs(analysis.hover.loop_poles))}"))
    columns = {
        analysis.scenario.name: analysis.metrics,
        "gust alone": analysis.gust_alone,
        "gyro noise alone": analysis.noise_alone,
    }
    parts.append(figures_table("Simulated in-process (bit-identical to UDP)", columns))
    parts.append(Text("Limits:"))
    parts += [Text(f"- {line}") for line in analysis.limits()]
    return Group(*parts)
