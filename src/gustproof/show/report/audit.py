"""Audits of simulators as tables."""

from collections.abc import Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gustproof.show.report.terminal import Renderable
from gustproof.studies.audit.checks import AuditVerdict, Row, format_values


def render_audit(name: str, rows: Sequence[Row]) -> Renderable:
    """Return the rows of an audit as a table, and how many tests passed."""
    table = Table(title=f"Audit of {name}")
    for heading, least in (("test", 10), ("measured", 34), ("expected", 12), ("found", 12), ("±", 6), ("", 13)):
        table.add_column(heading, min_width=least)
    for row in rows:
        cells = (row.measured, row.expected, format_values(row.found), row.tolerance, row.verdict.value)
        table.add_row(row.test, *cells)
    sources = "\n".join(dict.fromkeys(f"{row.test}: {row.source}" for row in rows))
    counts = {verdict: sum(row.verdict is verdict for row in rows) for verdict in AuditVerdict}
    said = ", ".join(f"{count} {verdict.value}" for verdict, count in counts.items())
    return Group(
        table, Text(f"Expected values are from\n{sources}"), Text(f"{said}; what is not reachable is not tested")
    )
