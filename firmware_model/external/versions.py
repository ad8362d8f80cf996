"""Versions of real autopilots as data: what differs between them, and which of them have been tried.

What a build says itself is read from it: how its start script takes parameters, whether a law is built into it. Its
version is told without starting it. The rest stands in `VERSIONS`, one table for each autopilot.
A version that has not been tried flies with a warning, by the row of the nearest.

References
----------
PX4 and ArduPilot, sources of the releases and of their main branches up to 2026.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

_FAR = 100  # second numbers that a first one counts as
_NUMBERS = re.compile(r"v?(\d+)\.(\d+)")
_ARDUCOPTER = re.compile(rb"ArduCopter V(\d+\.\d+\.\d+[\w-]*)")
_PX4_TAG = re.compile(rb'PX4_GIT_TAG_STR +"v?([^"]+)"')
_PX4_HEADER = Path("src/lib/version/build_git_version.h")
_PX4_PROGRAM = Path("bin/px4")
_PX4_INSIDE = re.compile(rb"\0v(\d+\.\d+\.\d+[\w.-]*)\0")  # in the program: an installed package has no header
_NONE: Mapping[str, float] = MappingProxyType({})


class Version(NamedTuple):
    """Peculiarities of a version of an autopilot, of all that is used here."""

    number: str
    """Its first two numbers."""
    tried: tuple[str, ...] = ()
    """Releases and states of it that were flown here; none if it is known from its sources alone."""
    absent: tuple[str, ...] = ()
    """Parameters that flights here set and that it does not have."""
    defaults: Mapping[str, float] = _NONE
    """Defaults of the loops [in their units] where they are not those of `gustproof.design.loops`."""
    has_law: bool = True
    """True if the folder of `gustproof export` builds in it."""


_PX4_OF_1_16, _PX4_OF_1_17 = ("MC_YAW_TQ_CUTOFF",), {"MC_ROLL_P": 4.0, "MC_PITCH_P": 4.0, "IMU_DGYRO_CUTOFF": 20.0}
_ARDUPILOT_OF_4_7, _ARDUPILOT_UNTIL_4_6 = ("ARMING_SKIPCHK",), ("ARMING_CHECK",)

VERSIONS: Mapping[str, tuple[Version, ...]] = {
    "px4": (
        Version("1.14", absent=_PX4_OF_1_16, has_law=False),  # no modes that a module registers
        Version("1.15", ("1.15.2",), absent=_PX4_OF_1_16),
        Version("1.16", ("main of February 2025", "1.16.1")),
        Version("1.17", ("main of October 2025", "main of March 2026"), defaults=_PX4_OF_1_17),
    ),
    "ardupilot": (  # before 4.6 motors do not tell their thrust
        Version("4.3", absent=_ARDUPILOT_OF_4_7, has_law=False),
        Version("4.4", absent=_ARDUPILOT_OF_4_7, has_law=False),
        Version("4.5", ("4.5.7",), absent=_ARDUPILOT_OF_4_7, has_law=False),
        Version("4.6", ("4.6.3",), absent=_ARDUPILOT_OF_4_7),
        Version("4.7", ("4.7-dev of July 2025",), absent=_ARDUPILOT_UNTIL_4_6),
        Version("4.8", ("4.8-dev of April 2026",), absent=_ARDUPILOT_UNTIL_4_6),
    ),
    "betaflight": (Version("4.6", ("4.6.0",), has_law=False),),
}
"""Versions by autopilot, from the oldest on."""


def read_version(kind: str, build: Path) -> str:
    """Return the version of a build, as `firmware_model.external` finds it; empty if it does not tell one."""
    try:
        if kind == "ardupilot":
            said = _ARDUCOPTER.search(build.read_bytes())
        elif kind == "px4":
            header = build / _PX4_HEADER
            path, pattern = (header, _PX4_TAG) if header.exists() else (build / _PX4_PROGRAM, _PX4_INSIDE)
            said = pattern.search(path.read_bytes())
        else:
            return ""
        return said[1].decode(errors="replace") if said else ""
    except OSError:
        pass
    return ""


def find_row(kind: str, version: str) -> Version | None:
    """Return the row of a version, or that of the nearest; `None` if no number is told."""
    numbers = _NUMBERS.match(version)
    if numbers is None:
        return None
    wanted = _FAR * int(numbers[1]) + int(numbers[2])
    return min(VERSIONS[kind], key=lambda row: abs(_place(row) - wanted))


def doubt_version(kind: str, version: str) -> str:
    """Return in words that a version has not been tried; empty for one that has, and for one that is not known."""
    numbers, tried = _NUMBERS.match(version), [row for row in VERSIONS.get(kind, ()) if row.tried]
    if numbers is None or f"{numbers[1]}.{numbers[2]}" in [row.number for row in tried]:
        return ""
    wanted = _FAR * int(numbers[1]) + int(numbers[2])
    nearest = min(tried, key=lambda row: abs(_place(row) - wanted))
    return f"{kind} {version} has not been tried here, {nearest.number} is the nearest that has"


def absent_parameters(kind: str, version: str) -> tuple[str, ...]:
    """Return the parameters of flights that a version lacks; without its number, all that any version does."""
    row = find_row(kind, version)
    return tuple(name for each in VERSIONS[kind] for name in each.absent) if row is None else row.absent


def describe_no_law(kind: str, version: str) -> str:
    """Return in words that a version has no place for a law, and which have; empty for one that has, or is unknown."""
    row = find_row(kind, version)
    if row is None or row.has_law:
        return ""
    others = [each.number for each in VERSIONS[kind] if each.has_law]
    return f"{kind} {version} has no place for one, {f'{others[0]} and later have' if others else 'as no version has'}"


def describe_tried(kind: str, *, with_law: bool = False) -> str:
    """Return in words the releases and states of an autopilot that were flown here, or those that a law can be in."""
    return ", ".join(each for row in VERSIONS[kind] for each in row.tried if row.has_law or not with_law)


def later_defaults(kind: str) -> tuple[str, Mapping[str, float]]:
    """Return the first version whose loops have other defaults than those here, and these; empty if none has."""
    found = next((row for row in VERSIONS[kind] if row.defaults), None)
    return ("", _NONE) if found is None else (found.number, found.defaults)


def _place(row: Version) -> int:
    first, second = map(int, row.number.split("."))
    return _FAR * first + second
