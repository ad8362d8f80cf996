"""A flight and a campaign leave what build servers and other programs read."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from pyulog import ULog
from typer.testing import CliRunner, Result

from gustproof.cli.app import app
from gustproof.flight.recording.bag import read_bag
from gustproof.flight.recording.folder import find_bag
from gustproof.flight.routes.flight import Flight
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.show.report.junit import flight_tests, render_suites


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(words: str) -> Result:
    return CliRunner().invoke(app, words.split())


def suite(name: str) -> ElementTree.Element:
    return ElementTree.parse(name).getroot()[0]


def test_a_flight_leaves_its_requirements_and_a_ulog() -> None:
    assert run("fly gust-roll --law hinf-d1 -o r -o a.xml -o a.ulg").exit_code == 1
    found = suite("a.xml")
    assert [found.get(name) for name in ("tests", "failures", "errors")] == ["4", "1", "0"]
    assert [case.get("name") for case in found if case.find("failure") is not None] == ["peak, roll [deg] ≤ 1"]
    assert run("report r -o b.ulg").exit_code == 0
    assert Path("a.ulg").read_bytes() == Path("b.ulg").read_bytes()
    attitude = ULog("b.ulg").get_dataset("vehicle_attitude").data
    _, records = read_bag(find_bag(Path("r")))
    assert attitude["q[1]"].tolist() == records["q_NB"][:, 1].astype("f4").tolist()


def test_a_flight_that_broke_off_is_an_error_and_its_words_stay_xml() -> None:
    from gustproof import fly_controller, load_law, load_scenario

    flown = fly_controller(load_scenario("gust-roll"), load_law("flagship"))
    broken: Flight = replace(flown, outcome=FlightOutcome.CONTROLLER_RAISED, message="raised \x1b[31mred\x00")
    found = ElementTree.fromstring(render_suites({"one": [*flight_tests(broken)]}).partition("?>")[2])[0]
    assert found.get("errors") == "1"
    assert found[0].find("error") is not None


def test_shards_leave_rows_that_the_same_command_makes_a_table() -> None:
    words = "campaign fly gust-roll --law flagship --runs 4 --workers 1 -o mc.parquet"
    for shard in ("1/2", "2/2"):
        result = run(f"{words} --shard {shard}")
        assert result.exit_code == 0, result.output
        assert f"shard {shard} is in mc.parquet.parts" in " ".join(result.output.split())
    assert run(words).exit_code == 0
    whole = Path("mc.parquet").read_bytes()
    assert run(words.replace("mc.", "one.")).exit_code == 0
    assert Path("one.parquet").read_bytes() == whole


def test_a_campaign_fails_the_requirement_that_a_run_did_not_meet() -> None:
    words = "campaign fly gust-roll --law hinf-d1 --runs 3 --workers 1 -o mc.parquet"
    assert run(f"{words} -o mc.xml").exit_code == 0
    found = suite("mc.xml")
    assert [found.get(name) for name in ("tests", "failures", "errors")] == ["4", "2", "0"]
    assert "met in 0 % (" in found[1].find("failure").get("message", "")  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("fly gust-roll -o a -o b", "two folders for one recording, a and b"),
        ("fly gust-roll -o a.xml --view", "a page can fly again"),
        ("fly gust-roll -o none/a.ulg", "none: no such folder"),
        ("campaign fly gust-roll -o a.parquet --shard 3/2", "--shard: is '3/2', must be I/N such as 2/8"),
        ("campaign fly gust-roll -o a.parquet --shard 1/2 --json", "a shard has no figures"),
        ("report none -o a.ulg", "none: no such file or folder"),
        ("report none other -o a.ulg", "a ULog holds one flight"),
        ("report none --from 3", "--json, --from, --to: of a log alone"),
    ],
)
def test_what_cannot_be_written_is_refused_before_a_flight(words: str, said: str) -> None:
    result = run(words)
    assert (result.exit_code, said in " ".join(result.output.split())) == (2, True), result.output
