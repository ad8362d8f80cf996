"""`gustproof guide` in Debian's Chromium: nothing is fetched, nothing complains, and everyone can read it."""

import subprocess
import sys
import time
from contextlib import suppress

import pytest

from gustproof.guide.site import SECTIONS

NAMES = [name for names in SECTIONS.values() for name in names]
SEEN = ("index", "tutorial", "keys-law", "laws")
"""Pages with pictures, code and tables; all pages have their one style sheet, so colours are checked on these."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guide")
    command = [sys.executable, "-m", "gustproof", "guide", "-o", str(folder), "--no-open"]
    subprocess.run(command, capture_output=True, text=True, check=True)
    return folder


@pytest.fixture
def opened(browser, folder):
    """Open a page, and check that it logs no complaint and requests nothing but its own files."""

    def see(name, **window):
        browser.open((folder / f"{name}.html").as_uri(), **window)
        browser.run("document.fonts.ready.then(() => true)")
        assert browser.complaints == [], name
        own = folder.as_uri() + "/"
        assert [request for request in browser.requests if not request.startswith((own, "data:"))] == [], name
        return browser

    return see


def test_axe_finds_no_fault_on_any_page(opened, axe):
    if not axe:
        pytest.skip("axe-core is not installed")
    faults = {}
    for dark, names in ((False, NAMES), (True, SEEN)):
        for name in names:
            browser = opened(name, width=1366, height=900, dark=dark)
            found = browser.violations(axe, colours=name in SEEN)
            faults |= {f"{name}, dark {dark}": found} if found else {}
    assert faults == {}


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1366, 390])
def test_pages_fit_their_window_and_can_be_read(opened, tmp_path, width, dark):
    for name in SEEN:
        browser = opened(name, width=width, height=844, dark=dark)
        assert browser.run("document.documentElement.scrollWidth") <= width, name
        ink, paper = browser.run("['color', 'backgroundColor'].map((key) => getComputedStyle(document.body)[key])")
        assert (brightness(ink) > brightness(paper)) is dark
        assert browser.run("[...document.images].every((image) => image.complete && image.naturalWidth > 0)")
        assert browser.faults() == [], name
        browser.screenshot(tmp_path / f"{name}-{width}-{'dark' if dark else 'light'}.png")
    assert len(list(tmp_path.glob("*.png"))) == len(SEEN)


def brightness(colour):
    return sum(int(part) for part in colour.removeprefix("rgb(").removesuffix(")").split(","))


def press(browser, key, code, text=None):
    for kind in ("keyDown", "keyUp"):
        shown = {"text": text} if text and kind == "keyDown" else {}
        browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **shown)


def press_tab(browser):
    press(browser, "Tab", 9)


def wait_for(browser, condition):
    end = time.monotonic() + 10.0
    while time.monotonic() < end:
        with suppress(AssertionError):  # a page that is being left answers nothing
            if browser.run(f"Boolean({condition})"):
                return
        time.sleep(0.02)
    pytest.fail(f"never: {condition}")


def test_the_search_is_used_by_the_keyboard_alone(opened):
    browser = opened("index", width=1366, height=900)
    press(browser, "/", 191, "/")
    assert browser.run("document.activeElement.type") == "search"
    browser.call("Input.insertText", text="structured singular value")
    wait_for(browser, "document.querySelector('[role=search] li')")
    press(browser, "ArrowDown", 40)
    assert browser.run("document.activeElement.href").rpartition("/")[2].startswith(("theory.html#", "glossary.html#"))
    press(browser, "Escape", 27)
    assert browser.run("document.querySelectorAll('[role=search] li').length") == 0
    browser.call("Input.insertText", text="coning drifts 51")
    wait_for(browser, "document.querySelector('[role=search] li')")
    press(browser, "Enter", 13, "\r")
    wait_for(browser, "document.title.startsWith('The theory')")
    assert browser.complaints == []


def test_code_is_copied_without_prompts(opened):
    browser = opened("tutorial", width=1366, height=900)
    browser.run("navigator.clipboard.writeText = async (text) => { globalThis.copied = text; }; true")
    browser.run("document.querySelectorAll('.copied button')[1].click()")
    wait_for(browser, "globalThis.copied")
    assert browser.run("copied").splitlines() == [
        "gustproof fly gust-roll --law hinf-d1 --output paper",
        "gustproof report ours paper -o compare.html",
    ]


def test_sections_of_a_page_are_listed_beside_it(opened):
    for width, shown in ((1366, True), (390, False)):
        browser = opened("tutorial", width=width, height=844)
        assert browser.run("document.querySelector('#sections details').open") is shown
        assert browser.run("document.querySelector('#sections a').hash") == "#see-a-gust"


def test_the_keyboard_reaches_text_tables_and_contents(opened):
    browser = opened("laws", width=1366, height=900)
    press_tab(browser)
    assert browser.run("document.activeElement.textContent") == "Skip to the text"
    assert browser.run("document.activeElement.getBoundingClientRect().left") >= 0  # shown once it has the focus
    reached = set()
    for _ in range(70):
        press_tab(browser)
        reached.add(
            browser.run("document.activeElement.closest('main, nav, .wide')?.id || document.activeElement.className")
        )
    assert {"wide", "contents"} <= reached


def test_the_contents_lead_from_page_to_page(opened):
    browser = opened("index", width=390, height=844)
    link = "document.querySelector('#contents a[href=\"px4.html\"]')"
    browser.run(f"{link}.click()")
    wait_for(browser, "document.querySelector('h1').textContent === 'For PX4 users'")
    assert browser.run("document.querySelector('[aria-current]').textContent") == "For PX4 users"
