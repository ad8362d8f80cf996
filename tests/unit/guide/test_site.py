"""The site of the guide needs no network, and is sound for keyboards and screen readers."""

import json
import re
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pytest
import typer.main
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.guide.rendering import heading_anchor, render_markdown
from gustproof.guide.site import MADE, SECTIONS, Page


class Reader(HTMLParser):
    """What a page says of itself."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.ids, self.headings = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.ids += [value for name, value in attrs if name == "id"]
        if re.fullmatch(r"h[1-6]", tag):
            self.headings.append(int(tag[1]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guide") / "site"
    folder.mkdir()
    (folder / "guide.css").write_text("", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gustproof.cli.options._FIRST_LINE_S", 0.01)
        result = CliRunner().invoke(app, ["guide", "tutorial", "-o", str(folder), "--no-open", "--force"])
    assert result.exit_code == 0, result.output
    assert result.stdout == f"{folder / 'tutorial.html'}\n"
    assert result.stderr.startswith(f"gustproof: writing {folder}: 0 s\n")
    return folder


@pytest.fixture(scope="module")
def pages(folder):
    return {path.stem: Reader(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.html"))}


@pytest.mark.slow
def test_every_page_of_the_contents_is_written(pages):
    assert set(pages) == {name for names in SECTIONS.values() for name in names}
    assert set(MADE) < set(pages)


@pytest.mark.slow
def test_nothing_is_fetched_and_every_link_leads_somewhere(pages, folder):
    for name, page in pages.items():
        for tag, attributes in page.tags:
            target = attributes.get("src") or attributes.get("href") or ""
            assert tag != "script" or attributes == {"src": "guide.js", "defer": None}
            if tag != "a":
                assert not re.match(r"\w+://|//", target), f"{name} fetches {target}"
            if target and "://" not in target and not target.startswith("data:"):
                file, _, anchor = target.partition("#")
                assert not file or (folder / file).is_file(), f"{name}: no {file}"
                if anchor:
                    assert anchor in pages[file.removesuffix(".html") or name].ids, f"{name}: no {target}"
    assert not re.search(r"url\(|@import", (folder / "guide.css").read_text(encoding="utf-8"))
    assert not re.search(r"fetch\(|://|import\b", (folder / "guide.js").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_search_knows_every_section_of_every_page(pages, folder):
    text = (folder / "search.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("guideIndex(").removesuffix(");\n"))
    assert {page for page, *_ in index} == set(pages)
    for page, anchor, *_ in index:
        assert anchor in pages[page].ids, f"{page}: {anchor}"
    assert sum(page == "glossary" for page, *_ in index) == pages["glossary"].headings.count(2) + 1
    assert any("coning" in words for page, *_, words in index if page == "theory")


def test_the_first_use_of_a_term_leads_to_its_entry(folder):
    theory = (folder / "theory.html").read_text(encoding="utf-8")
    assert theory.count('href="glossary.html#term-coning"') == 1
    assert re.search(
        r'<a href="glossary.html#term-ms" class="term" title="peak of the sensitivity[^"]*">Ms</a>', theory
    )
    assert 'class="term"' not in (folder / "glossary.html").read_text(encoding="utf-8")
    shown, _ = render_markdown("# leak\n\nno [leak](a.md), `leak`, a leak, a leak-free leak", {"leak": "of <it>"})
    assert shown.count('title="of &lt;it&gt;">leak</a>, a leak-free') == 1
    assert shown.count("glossary.html") == 1


def test_code_has_colours_and_long_pages_list_their_sections(folder):
    names = ("library", "tutorial", "course")
    library, tutorial, course = ((folder / f"{name}.html").read_text(encoding="utf-8") for name in names)
    assert '<span class="kn">import</span>' in library
    assert '<span class="gp">$ </span>gustproof' in tutorial
    assert '<nav id="sections" aria-label="On this page">' in tutorial
    assert '<a href="#prove">Prove</a>' in tutorial
    assert "On this page" not in course


def test_headings_landmarks_and_pictures_have_names(pages):
    for name, page in pages.items():
        tags = [tag for tag, _ in page.tags]
        assert page.headings[0] == 1, name
        assert page.headings.count(1) == 1, name
        assert all(after - before <= 1 for before, after in pairwise(page.headings)), name
        assert len(page.ids) == len(set(page.ids)), name
        assert (tags.count("main"), tags.count("header"), tags.count("footer")) == (1, 1, 1)
        assert all(attributes["aria-label"] for tag, attributes in page.tags if tag == "nav")
        assert all(len(attributes["alt"]) > 30 for tag, attributes in page.tags if tag == "img")
        assert ("html", {"lang": "en"}) in page.tags


def test_an_unknown_page_is_one_line(tmp_path):
    for name, said in (
        ("tutorail", "no page named 'tutorail'; did you mean 'tutorial'?"),
        ("zzz", "no page named 'zzz', there are index, install, tutorial"),
    ):
        result = CliRunner().invoke(app, ["guide", name, "-o", str(tmp_path), "--no-open"])
        assert (result.exit_code, said in result.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_a_guide_replaces_no_other_files(folder, tmp_path):
    assert (folder / "guide.css").stat().st_size > 1000  # in place of the one of a guide before
    (tmp_path / "index.html").write_text("mine")
    (tmp_path / "mine.txt").touch()
    for force, words in (((), "exists already"), (("--force",), "holds other files, such as mine.txt")):
        refused = CliRunner().invoke(app, ["guide", "-o", str(tmp_path), "--no-open", *force])
        assert refused.exit_code == 2
        assert words in refused.stderr
        assert (tmp_path / "index.html").read_text() == "mine"


def test_a_guide_without_a_folder_takes_the_same_place_in_the_cache_each_time(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("gustproof.guide.site.load_pages", lambda _: [Page("index", "Guide", "# Guide")])
    shown = {CliRunner().invoke(app, ["guide", "--no-open"]).stdout for _ in range(2)}
    assert shown == {f"{tmp_path / 'cache/gustproof/guide/index.html'}\n"}
    assert (tmp_path / "cache/gustproof/guide/guide.css").is_file()


@pytest.mark.parametrize("home", ["/dev/null", "/proc"])
def test_a_guide_without_a_home_takes_a_temporary_folder(home, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", home)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("gustproof.guide.site.load_pages", lambda _: [Page("index", "Guide", "# Guide")])
    result = CliRunner().invoke(app, ["guide", "--no-open"])
    assert (result.exit_code, Path(result.stdout.strip()).parent.parent) == (0, tmp_path)


def test_markdown_is_rendered_without_raw_html():
    shown, sections = render_markdown(
        "# A b\n\n<script>x</script>\n\n[p](px4.md#a) ![alt](pictures/x.png)\n\n| a |\n|---|\n| 1 |\n"
    )
    assert "<script>" not in shown
    assert [(part.level, part.anchor, part.title) for part in sections] == [(1, "a-b", "A b")]
    assert 'href="px4.html#a"' in shown
    assert '<a href="x.png" title="Enlarge the picture"><img src="x.png"' in shown
    assert '<h1 id="a-b">' in shown
    assert '<th scope="col">a</th>' in shown
    assert heading_anchor("`fly SCENARIO --law`, a flight") == "fly-scenario---law-a-flight"


def test_reference_has_every_command_key_and_message(folder):
    text = {path.stem: path.read_text(encoding="utf-8") for path in folder.glob("*.html")}
    commands = typer.main.get_command(app).commands
    assert all(f'<h2 id="gustproof-{name}' in text["options"] for name in commands)
    assert "--signing-key" in text["options"]  # of a command that parses its own options
    for word in ("duration_s", "one_minus_cosine", "burst_loss", "recovery_s", "actuator_effect"):
        assert word in text["keys-scenario"]
    for word in ("thrust_max", "gust_yaw_ratio", "Spread", "resistance_ohm"):
        assert word in text["keys-vehicle"]
    assert all(word in text["keys-design"] for word in ("W_e", "backoff", "InnerLoop", "misfit"))
    assert all(word in text["keys-law"] for word in ("gustproof-law-1", "rate_limit", "provenance", "(3, n) state"))
    assert all(
        word in text["topics"]
        for word in (
            "/truth/pose",
            "[N*m] actuator command",
            "gustproof_msgs/msg/Mode",
            "/events",
            "/requirements",
            "/attitude/error",
        )
    )
    assert all(
        word in text["messages"]
        for word in ("HIGHRES_IMU", "COMMAND_ACK", "PARAM_VALUE", "SET_ATTITUDE_TARGET", "MAV_CMD_DO_SET_MODE")
    )
    assert all(word in text["json"] for word in ("rmse_deg", "gamma_opt", "requirements", "certified_up_to_times"))
    assert "fly_direct(scenario, law" in re.sub(r"<[^>]*>", "", text["api"])
