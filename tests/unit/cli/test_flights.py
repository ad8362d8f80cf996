"""What `fly --view` does before Start: open the page where there is a screen, and compile while it is read."""

import webbrowser

import pytest

from gustproof.cli import flights
from gustproof.flight.routes import checkup


class Page:
    """The page's side of it."""

    def __init__(self) -> None:
        self.told: list[int] = []

    def tell_compiling(self, about_s: int) -> None:
        self.told.append(about_s)


@pytest.mark.parametrize("screen", ["", "DISPLAY", "WAYLAND_DISPLAY", "BROWSER"])
def test_a_browser_is_opened_only_where_there_is_a_screen(monkeypatch, screen):
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    if screen:
        monkeypatch.setenv(screen, "one")
    flights._open_page("http://127.0.0.1:1/")
    assert opened == ["http://127.0.0.1:1/"] * bool(screen)


@pytest.mark.parametrize("cold", [False, True])
def test_the_page_is_told_while_the_simulator_is_compiled(monkeypatch, cold):
    monkeypatch.setattr(checkup, "is_cold", lambda: cold)
    page = Page()
    flights._compile(page, quiet=True)
    assert page.told == [flights._COMPILING_S, 0] * cold
