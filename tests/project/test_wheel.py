"""The wheel that a user installs holds both packages with their data, and works away from the checkout."""

import json
import os
import re
import subprocess
import sys
import tomllib
import venv
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PACKAGES = {"firmware_model": ROOT / "firmware_model", "gustproof": ROOT / "src" / "gustproof"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--wheel-dir", str(folder), str(ROOT)], check=True)
    (path,) = folder.glob("gustproof-*.whl")
    return path


def test_the_wheel_holds_every_source_and_data_file_and_nothing_else(wheel: Path) -> None:
    expected = {
        f"{package}/{path.relative_to(folder).as_posix()}"
        for package, folder in PACKAGES.items()
        for path in folder.rglob("*")
        if path.is_file() and path.suffix not in {".pyc", ".nbi", ".nbc"}
    }
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert held == expected
    assert {Path(name).suffix for name in held} >= {".py", ".toml", ".json"}


def test_the_installed_wheel_flies_a_shipped_law_on_a_shipped_vehicle(wheel: Path, tmp_path: Path) -> None:
    target = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(target)]
    subprocess.run([*pip, str(wheel)], check=True)
    program = (
        "import json, firmware_model, gustproof\n"
        "from firmware_model.config.scenario import load_scenario\n"
        "from firmware_model.config.vehicle import load_vehicle\n"
        "from gustproof.law.form import load_law, list_laws\nfrom gustproof.law.step import step\n"
        "import numpy\n"
        "x, u = step(law := load_law('pid-default'), numpy.zeros(6), numpy.full(6, 0.1))\n"
        "print(json.dumps({'files': [firmware_model.__file__, gustproof.__file__], 'laws': list_laws(),\n"
        "    'vehicle': load_vehicle('iris').name, 'scenario': load_scenario('paper').name, 'u': u.tolist()}))\n"
    )
    clean = {**os.environ, "PYTHONPATH": str(target)}
    result = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=clean, capture_output=True, text=True, check=True
    )
    found = json.loads(result.stdout)
    assert all(Path(file).is_relative_to(target) for file in found["files"])
    assert "pid-default" in found["laws"]
    assert (found["vehicle"], found["scenario"]) == ("iris", "paper")
    command = [str(target / "bin" / "gustproof"), "--help"]
    shown = subprocess.run(command, cwd=tmp_path, env=clean, capture_output=True, text=True, check=True).stdout
    assert "reproduce" in shown


# An ignored error that is none is one under --strict: so types are seen, and names that are not there.
SCRIPT = """\
from gustproof import Law, fly_direct, load_law, load_scenario, load_vehicle, measure
from gustproof import fly_away  # type: ignore[attr-defined]

law: Law = load_law("hinf-d1")
load_law(1)  # type: ignore[arg-type]
scenario, vehicle = load_scenario("paper"), load_vehicle("paper")
records = fly_direct(scenario, law, vehicle=vehicle)
rmse: float = measure(records, vehicle, scenario).rmse_deg
"""


def test_script_on_the_installed_wheel_type_checks_in_an_empty_env(wheel: Path, tmp_path: Path) -> None:
    venv.create(tmp_path / "env")
    (packages,) = (tmp_path / "env").glob("lib/python*/site-packages")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    page = (ROOT / "src" / "gustproof" / "guide" / "matlab.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    files = {"script.py": SCRIPT, **{f"example_{k}.py": block for k, block in enumerate(blocks)}}
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    # python-control has no types, and numpy is not installed here
    (tmp_path / "mypy.ini").write_text("[mypy]\n[mypy-control,numpy]\nignore_missing_imports = true\n")
    mypy = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", os.devnull]
    command = [*mypy, "--python-executable", str(tmp_path / "env" / "bin" / "python"), *files]
    clean = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "MYPYPATH"}}
    result = subprocess.run(command, cwd=tmp_path, env=clean, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def requirements(name: str, extras: frozenset[str]) -> Iterator[Requirement]:
    """Yield the requirements of an installed distribution on this Python and system."""
    from importlib.metadata import requires

    for text in requires(name) or ():
        requirement = Requirement(text)
        if requirement.marker is None or any(requirement.marker.evaluate({"extra": e}) for e in extras | {""}):
            yield requirement


def test_every_package_that_is_installed_has_its_pinned_version() -> None:
    lines = (ROOT / "tools" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if not line.startswith("#")]
    assert all(str(pin.specifier).startswith("==") and pin.url is None for pin in pins)
    pinned = {canonicalize_name(pin.name) for pin in pins}
    seen: set[tuple[str, frozenset[str]]] = set()
    waiting: list[tuple[str, frozenset[str]]] = [("gustproof", frozenset({"test"}))]
    while waiting:
        seen.add(current := waiting.pop())
        for requirement in requirements(*current):
            name = canonicalize_name(requirement.name)
            assert name in pinned, f"{name}, which {current[0]} needs, is not in tools/constraints.txt"
            following = (name, frozenset(requirement.extras))
            if following not in seen:
                waiting.append(following)


def test_what_the_wheel_says_of_itself_is_what_pyproject_says(wheel: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = archive.read(name).decode()
        assert any(entry.endswith("licenses/LICENSE") for entry in archive.namelist())
    assert f"License-Expression: {project['license']}" in metadata
    assert f"Requires-Python: {project['requires-python']}" in metadata
