import pytest
from matplotlib.figure import Figure


@pytest.fixture
def drawn(monkeypatch):
    """Catch figures when they are saved, so that what they show can be asked."""
    caught: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: caught.append(self))
    return caught
