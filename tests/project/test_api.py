"""The public API: one list of names, loaded lazily, each with an example that runs."""

import doctest
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import gustproof
from gustproof import robust, stub_names

PACKAGE = Path(gustproof.__file__).parent
NAMES = sorted(set(gustproof.__all__) - {"__version__"})


def test_import_loads_nothing_but_the_standard_library() -> None:
    program = "import sys; before = set(sys.modules); import gustproof; print(*sorted(set(sys.modules) - before))"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    others = {name for name in loaded if name.partition(".")[0] not in sys.stdlib_module_names}
    assert others == {"gustproof", "gustproof.version"}


@pytest.mark.parametrize(("package", "count"), [(gustproof, 129), (robust, 49)])
def test_all_names_of_the_stub_can_be_imported(package: ModuleType, count: int) -> None:
    names = stub_names(package.__name__)
    assert set(names) == set(package.__all__) == set(dir(package))
    assert len(names) == count
    for public, (module, name) in names.items():
        assert getattr(package, public) is getattr(import_module(module), name)


def test_help_begins_with_lines_that_work() -> None:
    example = doctest.DocTestParser().get_doctest(str(gustproof.__doc__), {}, "gustproof", None, 0)
    assert 7 <= len(example.examples) <= 10
    assert doctest.DocTestRunner(verbose=False).run(example).failed == 0


def test_public_names_are_no_names_of_rooms() -> None:
    assert not set(NAMES) & {path.stem for path in PACKAGE.iterdir()}


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="'gustproof' has no attribute 'fly_away'"):
        _ = gustproof.fly_away  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", NAMES)
def test_example_in_the_docstring_runs(name: str) -> None:
    text = getattr(gustproof, name).__doc__
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
    assert example.examples
    report: list[str] = []
    doctest.DocTestRunner(verbose=False).run(example, out=report.append)
    assert not report, "".join(report)
