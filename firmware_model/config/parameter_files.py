"""Parameter files of autopilots: sets that users keep, and those shipped here."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from firmware_model.config.files import PARAMETER_SUFFIXES, read_text, shipped_path, write_text
from firmware_model.config.validation import sanitize_line
from firmware_model.errors import ConfigError

DATA = Path(__file__).parent / "data" / "parameters"
"""Folder of the shipped sets, one below for each autopilot."""
_NAME, _NUMBER = re.compile(r"[A-Z][A-Z0-9_]{0,63}"), re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_HEX = re.compile(r"0[xX][0-9a-fA-F]{1,8}")
_FORMS = (  # beside those of a name and a value alone
    re.compile(r"\d+[\s,=]+\d+[\s,=]+(\w+)[\s,=]+(\S+)[\s,=]+\w+"),  # QGroundControl
    re.compile(r"param\s+set(?:-default)?\s+(?:-s\s+)?(\w+)\s+(\S+)"),  # PX4's airframe files
    re.compile(r"[x ]? *[+*]? *(\w+) \[\d+,\d+\] : (\S+)"),  # `param show` in PX4's shell
)
_SCRIPT = re.compile(r"\s*(param\s+set|#!|\. \$\{R\})")  # begins lines of PX4's airframe files
_CLASS = re.compile(r"\s*\.\s.*\brc\.(?!mc_|vtol_)(\w+)_defaults\b")
_SHOWN_BESIDE = re.compile(r"Symbols: .*|\d+(/\d+)? parameters used\.?|[a-z]+> ?.*")
_AIRFRAME = re.compile(r"\d{3,6}_[^.]+(\.hil)?")  # names of PX4's airframe files, by their number
_MOST_INCLUDES, _FEW = 32, 4
GROUND_STATION_FORMS = {"px4": "1\t1\t{name}\t{value}\t{type}", "ardupilot": "{name},{value}"}
"""Lines of files that QGroundControl and Mission Planner load, by autopilot."""
_WHOLE = ("CA_AIRFRAME", "CA_ROTOR_COUNT")  # of those written with a type


def is_parameter_file(name_or_path: str | Path) -> bool:
    """Return whether a name is that of a parameter file, by its end; PX4's airframe files have none, but a number."""
    path = Path(name_or_path)
    return path.suffix.lower() in PARAMETER_SUFFIXES or (_AIRFRAME.fullmatch(path.name) is not None and path.is_file())


def read_parameters(name_or_path: str | Path, autopilot: str, remarks: list[str] | None = None) -> dict[str, str]:
    """Return the values by name of a parameter file, or of a shipped set, as they stand there.

    A line holds a name and a value, apart by spaces, tabs, a comma or an equals sign. Lines of QGroundControl, with
    system and component before and a type after these, are read too. So are those of MAVProxy with `@READONLY`, of
    `param show` in PX4's shell, and `param set-default` in its airframe files. A number sign begins a comment, and
    `@include` names a file beside this one. Hexadecimal numbers become decimal.

    Of a name that stands there twice the last value counts, as a ground station loads it. `remarks` takes this, and
    what can't be read: other lines of a script, and files that are included but not there. Without it such a line is
    refused.

    Raises
    ------
    ConfigError
        If there is no such file or set, a line holds no parameter, or it is the airframe file of no multicopter.
    """
    reader = _read(name_or_path, autopilot, remarks)
    if remarks is not None:
        remarks += reader.describe_repeated()
    return reader.values


def repeated_parameters(name_or_path: str | Path, autopilot: str) -> list[str]:
    """Return a line on the parameters that stand more than once in a file with different values, see `read_parameters`.

    Raises
    ------
    ConfigError
        As `read_parameters` does.
    """
    return _read(name_or_path, autopilot, remarks=[]).describe_repeated()


def _read(name_or_path: str | Path, autopilot: str, remarks: list[str] | None) -> "_Reader":
    path = Path(name_or_path)
    if not is_parameter_file(path):
        path = shipped_path("parameter set", name_or_path, DATA / autopilot, ".params")
    reader = _Reader(remarks)
    reader.read(path)
    return reader


class _Reader:
    """State of reading a file with those that it includes."""

    def __init__(self, remarks: list[str] | None) -> None:
        self.values: dict[str, str] = {}
        self._places: dict[str, str] = {}
        self._repeated: dict[str, str] = {}
        self._remarks, self._included = remarks, 0

    def read(self, path: Path) -> None:
        """Take the lines of a file."""
        lines = _read_lines(path)
        others = list[str]()
        if found := next(filter(None, map(_CLASS.match, lines)), None):
            raise ConfigError(f"{path}: takes rc.{found[1]}_defaults, those of no multicopter")
        for number, line in enumerate(lines, 1):
            words = _split(line)
            if words[:1] == ["@include"]:
                self._include(path, " ".join(words[1:]), number)
            elif len(words) == 2 and _NAME.fullmatch(words[0]) and _NUMBER.fullmatch(words[1]):
                self._take(words[0], words[1], f"{path.name} line {number}")
            elif words:
                others.append(f"line {number}: '{sanitize_line(line)}'")
        if others:
            self._tell(path, others, is_script=any(map(_SCRIPT.match, lines)))

    def _take(self, name: str, value: str, place: str) -> None:
        """Take a value; the last one of a name counts."""
        before = self.values.get(name, value)
        if float(before) != float(value):
            self._repeated[name] = f"{name} {before} in {self._places[name]}, {value} in {place}"
        self.values[name], self._places[name] = value, place

    def describe_repeated(self) -> list[str]:
        """Return a line on names with different values."""
        if not self._repeated:
            return []
        first, more = [*self._repeated.values()][:_FEW], len(self._repeated) - _FEW
        others = f" and {more} others" if more > 0 else ""
        return [f"{'; '.join(first)}{others}: given twice, the last counts, as a ground station loads it"]

    def _tell(self, path: Path, others: list[str], *, is_script: bool) -> None:
        """Remark on lines that are no parameters, or refuse them."""
        if self._remarks is None or not is_script:
            reason = "; semicolons separate nothing" if ";" in others[0] else ""
            raise ConfigError(f"{path}: {others[0]} is no name and value of a parameter{reason}")
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        self._remarks.append(f"{path.name}: a script, {others[0]}{more} not run, all its parameters count")

    def _include(self, path: Path, name: str, number: int) -> None:
        """Take the lines of a file that a line of another names."""
        self._included += 1
        if self._included > _MOST_INCLUDES:
            raise ConfigError(f"{path}: line {number}: more than {_MOST_INCLUDES} files are included")
        if self._remarks is not None and not (path.parent / name).exists():
            self._remarks.append(f"{path.name}: @include {sanitize_line(name)}: not there, its parameters are missing")
            return
        self.read(path.parent / name)


def _read_lines(path: Path) -> list[str]:
    try:
        return read_text(path, marked=True).splitlines()
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def _split(line: str) -> list[str]:
    """Return name and value of a line, no words of an empty one, and all words of any other."""
    text = line.partition("#")[0].strip()
    if _SHOWN_BESIDE.fullmatch(text):
        return []
    form = next((match for each in _FORMS if (match := each.fullmatch(text))), None)
    words = form.groups() if form else re.split(r"[\s,=]+", text)
    return [str(int(word, 16)) if _HEX.fullmatch(word) else word for word in words if word and word != "@READONLY"]


def write_parameters(values: Mapping[str, str], path: Path, form: str, head: Sequence[str] = ()) -> None:
    """Write parameters, one line each in the `form` of an autopilot, such as `{name} {value}`, below comments.

    A `{type}` in the form is that of MAV_PARAM_TYPE: 6 for whole numbers, 9 for others.
    """
    lines = [f"# {line}" for line in head]
    lines += [form.format(name=name, value=values[name], type=6 if name in _WHOLE else 9) for name in values]
    write_text(path, "\n".join(lines) + "\n")
