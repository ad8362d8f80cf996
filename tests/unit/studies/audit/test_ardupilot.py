"""The audit of ArduPilot's own quadrotor over MAVLink, against a stand-in; GUSTPROOF_ARDUPILOT names a real one."""

import os
from pathlib import Path

import pytest

from firmware_model.errors import ConfigError
from gustproof.studies.audit import ardupilot, checks
from gustproof.studies.audit.adapters import load_simulator
from gustproof.studies.audit.checks import AuditVerdict, audit

PEER = Path(__file__).parent
REAL = os.environ.get("GUSTPROOF_ARDUPILOT", "")


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "_FLIGHT_TIME", 40.0)
    monkeypatch.setattr(ardupilot, "_STILL_STATES", 20)


def verdicts(build: Path) -> dict[str, set[AuditVerdict]]:
    simulator = load_simulator("ardupilot", build)
    try:
        rows = audit(simulator)
    finally:
        simulator.close()
    return {test: {row.verdict for row in rows if row.test == test} for test in {row.test for row in rows}}


@pytest.mark.parametrize(
    ("fault", "failed"), [("", set()), ("wind", {"sign of wind"}), ("step", {"step of turbulence"})]
)
def test_faults_are_found_and_the_rest_is_not_reachable(
    monkeypatch: pytest.MonkeyPatch, fault: str, failed: set[str]
) -> None:
    monkeypatch.setenv("PEER_FAULT", fault)
    found = verdicts(PEER)
    assert {test for test, each in found.items() if AuditVerdict.FAILED in each} == failed
    assert found["rotor geometry"] == found["turbulence"] == found["seeds"] == {AuditVerdict.NOT_REACHABLE}
    assert AuditVerdict.NOT_REACHABLE in found["sign of wind"]  # down


def test_one_that_does_not_arm_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PEER_FAULT", "arming")
    monkeypatch.setattr(ardupilot, "_TIMEOUT_S", 2.0)
    with pytest.raises(ConfigError, match="audit ardupilot: no arming in 2 s"):
        verdicts(PEER)


@pytest.mark.skipif(not REAL, reason="GUSTPROOF_ARDUPILOT names no build of ArduPilot")
def test_real_one_blows_the_right_way_and_depends_on_the_step() -> None:
    found = verdicts(Path(REAL))
    assert AuditVerdict.PASSED in found["sign of wind"]
    assert found["step of turbulence"] == {AuditVerdict.FAILED}
