"""The page of how it is built names the rooms, files and tests that there are."""

import re
import tomllib
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = (files("gustproof.guide") / "built.md").read_text(encoding="utf-8")
ROOMS, VEHICLE_ROOMS = (
    [re.findall(r"`(\w+)`", first) for first in re.findall(r"^\| (`.*?) \|", table, flags=re.MULTILINE)]
    for table in re.findall(r"\| room of `.*?(?=\n\n)", PAGE, flags=re.DOTALL)
)
CODINGS = re.findall(r"^\| `([\w/.]+)`, (\S+).*? \| .* \| (.*) \|$", PAGE, flags=re.MULTILINE)


@pytest.mark.parametrize(("folder", "rooms"), [("src/gustproof", ROOMS), ("firmware_model", VEHICLE_ROOMS)])
def test_every_room_stands_there_above_those_that_it_imports(folder: str, rooms: list[list[str]]) -> None:
    inside = {path.stem for path in (ROOT / folder).iterdir() if path.suffix in {"", ".py"} and path.stem[:2] != "__"}
    order = [name for names in rooms for name in names]
    assert sorted(order) == sorted(inside)
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layers,) = (each["layers"] for each in contracts if each.get("containers") == [folder.rpartition("/")[2]])
    floors = [[name for name in layer.split(" | ") if name in order] for layer in layers]
    places = [sorted(map(order.index, names)) for names in floors if names]
    assert all(max(upper) < max(lower) for upper, lower in pairwise(places))


def test_every_file_and_folder_is_there() -> None:
    named = set(re.findall(r"`((?:src|tests|firmware_model)/[\w/.]+)`", PAGE))
    assert len(named) > 20
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_every_coding_of_a_laws_step_has_a_function_and_a_test() -> None:
    assert len(CODINGS) == 9
    for file, function, test in CODINGS[1:]:
        name = re.findall(r"`(\w+)", function)[0]
        assert re.search(rf"^(?:def|class) {name}\(?", (ROOT / file).read_text("utf-8"), flags=re.MULTILINE), name
        tests, name = re.findall(r"`([\w/.]+)`", test)
        assert f"\ndef {name}(" in (ROOT / tests).read_text("utf-8"), name


def test_every_file_that_codes_the_step_is_in_the_table() -> None:
    """A coding knows the excess of the rate commanded from attitude."""
    sources = (ROOT / "src" / "gustproof").rglob("*.py")
    found = {str(path.relative_to(ROOT)) for path in sources if "rate_excess" in path.read_text(encoding="utf-8")}
    assert found <= {file for file, *_ in CODINGS}
    assert len(found) == 4
