"""Programs of plain sockets, each with one fault that `controller check` finds by its name."""

import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.protocol_check.findings import ASKED, Finding
from gustproof.flight.protocol_check.inspection import check_controller

CLIENT = Path(__file__).parent / "clients" / "programs" / "raw_client.py"
FAULTS = {
    "no-heartbeat": "none among",
    "wrong-stamp": "rejected as",
    "not-finite": "rejected as not_finite, the first: SET_ACTUATOR_CONTROL_TARGET nan",
    "silent": "no set-point came",
    "flooding": " datagrams a sample",
    "died": "ended with status 1: ValueError: the solver found no solution, at sample 101",
    "wrong-system-id": "messages are from system 42",
    "wrong-units": "% of the set-points are beyond the limits",
    "never-arms": "no command to arm came",
    "wrong-sign": "pushed along the rotation",
    "ignores-repeats": "no answer to sample 30",
    "unequal-answers": "sample 30: ",
}
"""What is seen of each fault. `late` flies alone, as it is about time."""


def check(fault: str) -> list[Finding]:
    """Return what is found, but for deadlines that nobody could keep: on a busy machine the vehicle is late itself."""
    entry = parse_controller(f"exec: '{sys.executable}' -S '{CLIENT}' {fault}")
    found = check_controller(entry, vehicle=load_vehicle("paper"), patience_s=2.0)
    return [finding for finding in found if finding.name != "not-judged"]


@pytest.fixture(scope="module")
def found() -> Mapping[str, list[Finding]]:
    """Return what is found of each fault; the checks wait for clocks most of their time, so they run side by side."""
    with ThreadPoolExecutor(4) as pool:
        return dict(zip(FAULTS, pool.map(check, FAULTS), strict=True))


def only(findings: list[Finding]) -> Finding:
    """Return the one finding; on a busy machine a program that does too much is late, too."""
    (finding,) = [finding for finding in findings if finding.name != "late"]
    return finding


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_found_by_its_name_alone(fault, found):
    finding = only(found[fault])
    assert finding.name == fault
    assert FAULTS[fault] in finding.seen
    assert finding.to_dict()["asked"] == ASKED[fault]


def test_flooding_is_counted_but_for_what_still_waits_at_the_end(found):
    seen = int(only(found["flooding"]).seen.split()[0])
    assert 8 <= seen <= 20  # ten are sent, and ten more if a busy machine asks again; up to 512 wait their turn


def test_late_answers_are_found_in_real_time():
    found = next(filter(None, (check("late") for _ in range(5))))
    assert [(finding.name, finding.trial) for finding in found] == [("late", "real time")]


def test_sound_client_is_found_sound():
    assert check("") == []
