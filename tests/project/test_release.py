"""What a release promises: version and date, licences of all that is installed, forms for contributors."""

import re
import tarfile
import tomllib
from importlib.metadata import PackageNotFoundError, metadata, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from gustproof.version import __version__

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSIONS = ["3.11", "3.12", "3.13"]
PAGE = (ROOT / "src" / "gustproof" / "guide" / "install.md").read_text(encoding="utf-8")
ALLOWED = {
    "BSD": r"\bBSD\b|\b0BSD\b|matplotlib project|^BSD",
    "MIT and alike": r"\bMIT\b|ISC",
    "Apache 2.0": r"Apache-2.0|Apache Software",
    "PSF": r"PSF|Python Software Foundation",
    "any OSI licence": r"any-OSI",
    "LGPL 3": r"LGPL",
}
"""Licences that a dependency may have, by the name of the guide's table."""


def installed() -> set[str]:
    """Return the names of all packages that an install of gustproof brings, itself left out."""
    found, waiting = set(), ["gustproof"]
    while waiting:
        name = waiting.pop()
        for requirement in map(Requirement, requires(name) or ()):
            wanted = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
            if wanted and (key := canonicalize_name(requirement.name)) not in found:
                found.add(key)
                waiting.append(key)
    return found


def licence(name: str) -> str:
    told = metadata(name)
    classified = [line for line in told.get_all("Classifier", []) if line.startswith("License ::")]
    return " ".join([told.get("License-Expression") or "", (told.get("License") or "")[:60], *classified])


def listed() -> dict[str, str]:
    """Return the licence of each package in the guide's table."""
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", PAGE.partition("## Licences")[2], flags=re.MULTILINE)
    return {name: row for row, names in rows[1:] for name in names.split(", ")}


def test_the_guide_lists_every_package_that_is_installed() -> None:
    assert set(listed()) - {"backports-zstd", "tzdata"} == installed() - {"backports-zstd", "tzdata"}  # of some systems


@pytest.mark.parametrize("name", sorted(listed()))
def test_a_package_has_the_licence_of_the_table(name: str) -> None:
    try:
        told = licence(name)
    except PackageNotFoundError:
        pytest.skip("is not needed on this system")
    kind = listed()[name].partition(",")[0]
    assert re.search(ALLOWED[kind], told), told


def test_the_changelog_begins_with_this_version_and_its_date() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## \[(.+?)\](?: - (\d{4}-\d\d-\d\d))?$", text, flags=re.MULTILINE)
    assert next(heading for heading in headings if heading[1]) == (__version__, "2026-11-23")
    assert len(text.splitlines()) <= 120


def test_versions_of_python_are_those_of_the_guide() -> None:
    minors = re.findall(r"Python :: (3\.\d+)'", str(PROJECT["classifiers"]))
    assert minors == VERSIONS
    assert PROJECT["requires-python"] == f">={minors[0]}"
    tried = re.findall(r"^\| (3\.\d+)\.\d+ \|", PAGE, flags=re.MULTILINE)
    assert sorted(set(tried)) == minors


def test_forms_and_the_container_name_files_and_commands_that_there_are() -> None:
    folder = ROOT / ".github"
    files = {
        "CONTRIBUTING.md",
        "SECURITY.md",
        "bug.yml",
        "config.yml",
        "idea.yml",
        "pages.yml",
        "test.yml",
        "action.yml",
    }
    assert {path.name for path in folder.rglob("*") if path.is_file()} == files
    site = (folder / "workflows" / "pages.yml").read_text(encoding="utf-8")
    assert "gustproof guide -o site --no-open" in site
    assert not re.search(r"secrets\.|https?://", site)
    recipe = (ROOT / "tools" / "Containerfile").read_text(encoding="utf-8")
    copied = [word for line in re.findall(r"^COPY (.+) \S+$", recipe, flags=re.MULTILINE) for word in line.split()]
    assert copied
    workflow = (folder / "workflows" / "test.yml").read_text(encoding="utf-8")
    run = re.findall(r"run: (tools/\w+)", workflow)
    assert run == ["tools/test", "tools/versions"]
    assert all((ROOT / word).exists() for word in (*copied, *run))
    assert re.findall(r'"(3\.\d+)"', workflow.partition("matrix:")[2].partition("include:")[0]) == VERSIONS


def test_each_dependency_stands_in_the_guide_with_its_reason() -> None:
    rows = re.findall(r"^\| ([^|]+) \| (\d+) \| (\S[^|]+) \|$", PAGE, flags=re.MULTILINE)
    reasons = {canonicalize_name(name): reason for names, _, reason in rows for name in names.split(", ")}
    direct = {canonicalize_name(Requirement(line).name) for line in PROJECT["dependencies"]}
    assert direct <= set(reasons)
    assert all(len(reason.split()) >= 2 for reason in reasons.values())


def test_minimum_versions_of_the_guide_are_those_of_the_project() -> None:
    told = dict(
        re.findall(r"(\w[\w.-]*) (\d+(?:\.\d+)+)", PAGE.partition("oldest packages:")[2].partition("and the")[0])
    )
    least = {
        requirement.name: next(iter(requirement.specifier)).version
        for requirement in map(Requirement, PROJECT["dependencies"])
    }
    assert told
    assert {name: Version(version) for name, version in told.items()} == {name: Version(least[name]) for name in told}


def test_the_source_archive_holds_what_is_built_and_no_test_data(tmp_path: Path) -> None:
    from hatchling.builders.sdist import SdistBuilder

    (path,) = SdistBuilder(str(ROOT)).build(directory=str(tmp_path))
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"pyproject.toml", "LICENSE", "README.md", "src/gustproof/py.typed", "firmware_model/py.typed"} <= names
    assert not [name for name in names if name.startswith(("tests/", "runs/", ".venv/"))]
