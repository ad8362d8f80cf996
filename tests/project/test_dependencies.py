"""Packages import only dependencies that they declare: the tests' tools are not there for users."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = {name: lines for name, lines in PROJECT["optional-dependencies"].items() if name != "test"}
USED = {"fastcrc"}  # by firmware_model alone
OWN = {"gustproof", "firmware_model", "_typeshed"}  # the last is for type checkers alone


def distribution(requirement: str) -> str:
    """Return the name of a distribution in one form."""
    return re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", requirement)[0]).lower()


def imported(path: Path) -> set[str]:
    """Return the top-level packages that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize("package", [ROOT / "src" / "gustproof", ROOT / "firmware_model"], ids=lambda path: path.name)
def test_every_package_that_is_imported_is_declared(package: Path) -> None:
    declared = {
        distribution(line) for line in [*PROJECT["dependencies"], *(x for lines in EXTRAS.values() for x in lines)]
    }
    declared |= {"llvmlite", "pydantic-core"}  # of numba and pydantic, at the versions that they ask for
    declared |= {"ipython"}  # is there where a notebook runs, and imported nowhere else
    known = packages_distributions()
    files = [path for path in package.rglob("*.py") if path.parent.name != "clients"]  # programs of users
    foreign = set().union(*map(imported, files)) - set(sys.stdlib_module_names) - OWN
    assert foreign
    assert package.name != "gustproof" or {distribution(line) for line in PROJECT["dependencies"]} <= USED | {
        distribution(name) for module in foreign for name in known.get(module, [])
    }
    assert {
        name: known.get(name) for name in foreign if not declared & set(map(distribution, known.get(name, [name])))
    } == {}
