"""What `controller check` prints, and its exit status; tests/conformance flies controllers of all kinds."""

import json

import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.flight.protocol_check.findings import ASKED, Finding

LATE = Finding(name="late", seen="half of the answers took 30 ms", trial="real time")


@pytest.fixture
def run(monkeypatch):
    def check(found, *arguments):
        monkeypatch.setattr("gustproof.flight.protocol_check.inspection.check_controller", lambda *_, **__: found)
        return CliRunner().invoke(app, ["controller", "check", *arguments])

    return check


def test_sound_controller_is_told_in_one_line(run):
    result = run([], "exec: sh")
    assert (result.exit_code, result.output) == (0, "'sh' keeps to the protocol\n")


def test_finding_has_its_name_what_was_seen_and_what_is_asked(run):
    result = run([LATE], "hinf-d1")
    assert result.exit_code == 1
    assert result.stdout.splitlines() == [
        "late: half of the answers took 30 ms (real time)",
        f"    the protocol asks: {ASKED['late']}",
    ]
    assert result.stderr == "gustproof: 'hinf-d1': late\n"


def test_json_has_the_findings(run):
    result = run([LATE], "exec: sh", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout) == {"controller": "sh", "findings": [LATE.to_dict()]}


def test_controller_that_is_none_is_told(run):
    result = run([], "nothing")
    assert result.exit_code == 2
    assert "no law named 'nothing'" in result.stderr
