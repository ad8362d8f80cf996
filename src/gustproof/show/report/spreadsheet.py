"""Text in tables that a spreadsheet opens."""

import re

_FORMULA = re.compile(r"[=+\-@\t\r]")
_NUMBER = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?", re.IGNORECASE)


def quote_text(cell: str) -> str:
    """Return a cell; text that a spreadsheet would compute as a formula gets an apostrophe, numbers stay.

    Names of laws come from files of others. For the characters see OWASP, CSV Injection.
    """
    return f"'{cell}" if _FORMULA.match(cell) and not _NUMBER.fullmatch(cell) else cell
