"""Versions of builds, and what is said of those that have not been tried."""

from pathlib import Path

import pytest

from firmware_model.external.versions import TRIED, doubt_version, read_version
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
        ("ardupilot", "4.3.8", "ardupilot 4.3.8 has not been tried here, 4.6 is the nearest that has"),
    ],
)
def test_a_build_tells_its_version_and_one_that_was_not_tried_is_doubted(tmp_path, kind, version, said) -> None:
    made = build(tmp_path, kind, version)
    assert read_version(kind, made) == version
    assert doubt_version(kind, f"{version} (cbbb353e)") == said.replace(version, f"{version} (cbbb353e)")
    check = check_autopilot(kind, lambda _: made)
    assert check.status is (Status.WARNING if said else Status.OK)
    assert version in check.found


def test_a_build_that_tells_no_version_is_not_doubted(tmp_path) -> None:
    for kind in TRIED:
        assert read_version(kind, tmp_path) == ""
        assert doubt_version(kind, "") == ""
        assert check_autopilot(kind, lambda _: tmp_path).status is Status.OK
