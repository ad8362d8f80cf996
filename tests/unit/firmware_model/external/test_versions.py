"""Versions of builds, and what is said of those that have not been tried."""

from pathlib import Path

import pytest

import gustproof
from firmware_model.external.versions import (
    VERSIONS,
    absent_parameters,
    describe_no_law,
    describe_tried,
    doubt_version,
    find_row,
    later_defaults,
    read_version,
)
from gustproof.flight.routes.checkup import Status, check_autopilot

HEADER = '#define PX4_GIT_VERSION_STR "a441"\n#define PX4_GIT_TAG_STR "{}"\n#define NUTTX_GIT_TAG_STR  "v11.0.0"\n'


def build(folder: Path, kind: str, version: str) -> Path:
    if kind == "ardupilot":
        (folder / "arducopter").write_bytes(b"\x7fELF\0ArduPlane V9.9.9\0ArduCopter V" + version.encode() + b"\0")
        return folder / "arducopter"
    header = folder / "src/lib/version/build_git_version.h"
    header.parent.mkdir(parents=True)
    header.write_text(HEADER.format(f"v{version}"))
    return folder


@pytest.mark.parametrize(
    ("kind", "version", "said"),
    [
        ("px4", "1.17.0", ""),
        ("px4", "1.16.1-12-gabcdef", ""),
        ("px4", "1.13.3", "px4 1.13.3 has not been tried here, 1.15 is the nearest that has"),
        ("px4", "2.0.0", "px4 2.0.0 has not been tried here, 1.17 is the nearest that has"),
        ("ardupilot", "4.6.3", ""),
        ("ardupilot", "4.9.0-dev", "ardupilot 4.9.0-dev has not been tried here, 4.8 is the nearest that has"),
        ("ardupilot", "4.3.8", "ardupilot 4.3.8 has not been tried here, 4.5 is the nearest that has"),
    ],
)
def test_a_build_tells_its_version_and_one_that_was_not_tried_is_doubted(tmp_path, kind, version, said) -> None:
    made = build(tmp_path, kind, version)
    assert read_version(kind, made) == version
    assert doubt_version(kind, f"{version} (cbbb353e)") == said.replace(version, f"{version} (cbbb353e)")
    check = check_autopilot(kind, lambda _: made)
    assert check.status is (Status.WARNING if said else Status.OK)
    assert version in check.found


def test_an_installed_px4_tells_its_version_in_its_program(tmp_path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/px4").write_bytes(b"\x7fELF\0v11.0.0 \0v1.17.0-beta1\0v9\0")
    assert read_version("px4", tmp_path) == "1.17.0-beta1"


def test_a_build_that_tells_no_version_is_not_doubted(tmp_path) -> None:
    for kind in VERSIONS:
        assert read_version(kind, tmp_path) == ""
        assert doubt_version(kind, "") == ""
        assert check_autopilot(kind, lambda _: tmp_path).status is Status.OK


@pytest.mark.parametrize(
    ("kind", "version", "absent"),
    [
        ("px4", "1.12.3", ("MC_YAW_TQ_CUTOFF",)),  # by the nearest, 1.14
        ("px4", "1.15.2", ("MC_YAW_TQ_CUTOFF",)),
        ("px4", "1.16.1", ()),
        ("px4", "1.19.0-alpha1", ()),
        ("px4", "", ("MC_YAW_TQ_CUTOFF", "MC_YAW_TQ_CUTOFF")),  # not told: what any version lacks
        ("ardupilot", "4.5.7", ("ARMING_SKIPCHK",)),
        ("ardupilot", "4.8.0-dev", ("ARMING_CHECK",)),
    ],
)
def test_what_a_version_lacks_is_that_of_the_nearest_row(kind: str, version: str, absent: tuple[str, ...]) -> None:
    assert absent_parameters(kind, version) == absent


@pytest.mark.parametrize(
    ("kind", "version", "said"),
    [
        ("px4", "1.14.4", "px4 1.14.4 has no place for one, 1.15 and later have"),
        ("px4", "1.15.2", ""),
        ("px4", "", ""),
        ("ardupilot", "4.3.8", "ardupilot 4.3.8 has no place for one, 4.6 and later have"),
        ("ardupilot", "4.6.0", ""),
        ("betaflight", "4.6.0", "betaflight 4.6.0 has no place for one, as no version has"),
    ],
)
def test_version_without_a_place_for_a_law_is_told_with_those_that_have(kind: str, version: str, said: str) -> None:
    assert describe_no_law(kind, version) == said


@pytest.mark.parametrize("kind", VERSIONS)
def test_rows_are_in_order_and_each_finds_itself(kind: str) -> None:
    rows = VERSIONS[kind]
    assert [find_row(kind, f"v{row.number}.9-rc1") for row in rows] == list(rows)
    assert list(rows) == sorted(rows, key=lambda row: tuple(map(int, row.number.split("."))))
    assert find_row(kind, "unknown") is None


def test_versions_tried_are_those_of_the_guide() -> None:
    page = (Path(gustproof.__file__).parent / "guide/autopilots.md").read_text()
    table = page.partition("## Versions tried")[2].partition("##")[0]
    for kind in VERSIONS:
        for each in describe_tried(kind).split(", "):
            assert each.removeprefix("main of ") in table
    assert describe_tried("ardupilot").startswith("4.5.7, ")
    assert describe_tried("ardupilot", with_law=True).startswith("4.6.3, ")


def test_defaults_that_a_version_changed_are_told_with_it() -> None:
    assert later_defaults("px4") == ("1.17", {"MC_ROLL_P": 4.0, "MC_PITCH_P": 4.0, "IMU_DGYRO_CUTOFF": 20.0})
    assert later_defaults("ardupilot") == ("", {})
