"""No name of a law is a formula in a spreadsheet, and numbers stay numbers."""

import pytest

from gustproof.show.report.spreadsheet import quote_text


@pytest.mark.parametrize("name", ["=1+1", '=HYPERLINK("mailto:a@b","x")', "+1+1", "-2+3", "@SUM(A1)", "\t=1", "--1"])
def test_a_formula_is_quoted(name):
    assert quote_text(name) == f"'{name}"


@pytest.mark.parametrize("cell", ["flagship", "-0.25", "+1e-3", "-.5E+7", "", "a=b", "a-b", "10.0 (9.1 .. 10.0)"])
def test_numbers_and_plain_names_stay(cell):
    assert quote_text(cell) == cell
