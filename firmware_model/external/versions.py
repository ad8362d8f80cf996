"""Versions of real autopilots: told by a build that is not started, and which of them have been tried.

A version that has not been tried flies with a warning: parameters and messages are those of the nearest that has.
"""

import re
from pathlib import Path

TRIED = {"px4": ("1.15", "1.16", "1.17"), "ardupilot": ("4.6", "4.7", "4.8"), "betaflight": ("4.6",)}
"""Versions that were flown here, by autopilot: their first two numbers."""
_FAR = 100  # second numbers that a first one counts as
_NUMBERS = re.compile(r"v?(\d+)\.(\d+)")
_ARDUCOPTER = re.compile(rb"ArduCopter V(\d+\.\d+\.\d+[\w-]*)")
_PX4_TAG = re.compile(r'PX4_GIT_TAG_STR +"v?([^"]+)"')
_PX4_HEADER = Path("src/lib/version/build_git_version.h")


def read_version(kind: str, build: Path) -> str:
    """Return the version of a build, as `firmware_model.external` finds it; empty if it does not tell one."""
    try:
        if kind == "ardupilot":
            said = _ARDUCOPTER.search(build.read_bytes())
            return said[1].decode() if said else ""
        if kind == "px4":
            tag = _PX4_TAG.search((build / _PX4_HEADER).read_text(encoding="utf-8", errors="replace"))
            return tag[1] if tag else ""
    except OSError:
        pass
    return ""


def doubt_version(kind: str, version: str) -> str:
    """Return in words that a version has not been tried; empty for one that has, and for one that is not known."""
    numbers = _NUMBERS.match(version)
    if numbers is None or f"{numbers[1]}.{numbers[2]}" in TRIED.get(kind, ()):
        return ""
    tried = [tuple(map(int, each.split("."))) for each in TRIED[kind]]
    nearest = min(tried, key=lambda each: abs(_FAR * (each[0] - int(numbers[1])) + each[1] - int(numbers[2])))
    return f"{kind} {version} has not been tried here, {nearest[0]}.{nearest[1]} is the nearest that has"
