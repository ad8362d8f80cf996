"""Parameter files of autopilots: sets that users keep, and those shipped here."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from firmware_model.config.files import read_text, shipped_path, write_text
from firmware_model.config.validation import sanitize_line
from firmware_model.errors import ConfigError

DATA = Path(__file__).parent / "data" / "parameters"
"""Folder of the shipped sets, one below for each autopilot."""
_NAME, _NUMBER = re.compile(r"[A-Z][A-Z0-9_]{0,15}"), re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
SUFFIXES = (".params", ".param", ".parm")
"""Ends of the names of parameter files."""
GROUND_STATION_FORMS = {"px4": "1\t1\t{name}\t{value}\t{type}", "ardupilot": "{name},{value}"}
"""Lines of files that QGroundControl and Mission Planner load, by autopilot."""
_WHOLE = ("CA_AIRFRAME", "CA_ROTOR_COUNT")  # of those written with a type


def read_parameters(name_or_path: str | Path, autopilot: str) -> dict[str, str]:
    """Return the values by name of a parameter file, or of a shipped set, as they stand there.

    A line holds a name and a value, apart by spaces, tabs, a comma or an equals sign. Lines of QGroundControl, with
    system and component before and a type after these, are read too. A number sign begins a comment.

    Raises
    ------
    ConfigError
        If there is no such file or set, or a line holds no parameter.
    """
    path = Path(name_or_path)
    if path.suffix not in SUFFIXES:
        path = shipped_path("parameter set", name_or_path, DATA / autopilot, ".params")
    try:
        text = read_text(path)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    values: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = _split(line)
        if words and not (len(words) == 2 and _NAME.fullmatch(words[0]) and _NUMBER.fullmatch(words[1])):
            raise ConfigError(f"{path}: line {number}: '{sanitize_line(line)}' is no name and value of a parameter")
        values |= {words[0]: words[1]} if words else {}
    return values


def _split(line: str) -> list[str]:
    """Return name and value of a line, no words of an empty one, and all words of any other."""
    words = re.split(r"[\s,=]+", line.partition("#")[0].strip())
    if len(words) == 5 and words[0].isdigit() and words[1].isdigit():
        return words[2:4]
    return [word for word in words if word]


def write_parameters(values: Mapping[str, str], path: Path, form: str, head: Sequence[str] = ()) -> None:
    """Write parameters, one line each in the `form` of an autopilot, such as `{name} {value}`, below comments.

    A `{type}` in the form is that of MAV_PARAM_TYPE: 6 for whole numbers, 9 for others.
    """
    lines = [f"# {line}" for line in head]
    lines += [form.format(name=name, value=values[name], type=6 if name in _WHOLE else 9) for name in values]
    write_text(path, "\n".join(lines) + "\n")
