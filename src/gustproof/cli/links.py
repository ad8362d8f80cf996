"""Options that processes with a MAVLink link have in common."""

from pathlib import Path
from typing import Annotated

import typer

SCENARIO = "a .toml file, or the name of a shipped one"
SigningKey = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Key that signs every message, 32 bytes or 64 hex digits, readable by you alone; none to obey anyone.",
    ),
]
JsonLines = Annotated[bool, typer.Option("--json", help="Print JSON, one object a line.")]
