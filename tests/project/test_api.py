"""The public API: one list of names, loaded lazily, each with an example that runs."""

import ast
import doctest
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import gustproof

PACKAGE = Path(gustproof.__file__).parent
NAMES = sorted(set(gustproof.__all__) - {"__version__"})


def test_import_loads_nothing_but_the_standard_library() -> None:
    program = "import sys; before = set(sys.modules); import gustproof; print(*sorted(set(sys.modules) - before))"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    others = {name for name in loaded if name.partition(".")[0] not in sys.stdlib_module_names}
    assert others == {"gustproof", "gustproof.version"}


def test_all_names_of_the_stub_can_be_imported() -> None:
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    assert len(imports) == len(stub.body)
    seen = {name.asname: (node.module, name.name) for node in imports for name in node.names}
    assert len(seen) == sum(len(node.names) for node in imports) == 122
    assert set(seen) == set(gustproof.__all__) == set(dir(gustproof))
    for public, (module, name) in seen.items():
        assert getattr(gustproof, str(public)) is getattr(import_module(str(module)), name)


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
