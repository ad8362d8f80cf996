"""Catalogues of shipped files: what tells one from the other stands in its line."""

import pytest

from gustproof.show.report.catalogue import CATALOGUES, summarize_all


@pytest.mark.parametrize("kind", CATALOGUES)
def test_no_two_files_are_described_alike(kind):
    described = [each["description"] for each in summarize_all(CATALOGUES[kind])]
    assert len(set(described)) == len(described)
    assert all(described)


def test_the_default_law_and_what_the_robust_one_keeps_are_told():
    described = {each["name"]: each["description"] for each in summarize_all(CATALOGUES["law"])}
    assert [name for name, text in described.items() if text.endswith("; the default")] == ["flagship"]
    assert described["flagship-robust"].endswith(", stable at 11 samples of delay and 7.3 times the gain")
