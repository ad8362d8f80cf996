"""Every field of every dataclass and NamedTuple has a docstring, and every number a unit."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = sorted([*(ROOT / "firmware_model").rglob("*.py"), *(ROOT / "src" / "gustproof").rglob("*.py")])
# Types of the project that stand for real numbers; a whole number is a count unless its name has a unit.
REAL = {"float", "Matrix", "Array", "Vector", "ComplexVector", "ComplexMatrix", "NDArray",
        "Positive", "NonNegative", "Finite", "PositiveVector"}  # fmt: skip
UNIT_IN_NAME = re.compile(r"_(us|ms|s|hz|deg|nm|mps|rad_s)$")
UNIT = re.compile(r"\[[^\[\]]+\]")
# Gains between vectors of several units have a shape instead.
SHAPE = re.compile(r"\([\w +*-]+,[\w +*,-]*\)")


def is_record(node: ast.ClassDef) -> bool:
    """Return whether a class is a dataclass or a public NamedTuple, other than a kernel's row of floats."""
    types = {ast.unparse(item.annotation) for item in node.body if isinstance(item, ast.AnnAssign)}
    named_tuple = any("NamedTuple" in ast.unparse(base) for base in node.bases)
    public = named_tuple and types != {"float"} and not node.name.startswith("_")
    return public or any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list)


def fields(source: str) -> Iterator[tuple[str, ast.AnnAssign, str | None]]:
    """Yield class and field name, the field, and its attribute docstring, of each record in `source`."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ClassDef) or not is_record(node):
            continue
        for item, following in zip(node.body, [*node.body[1:], None], strict=True):
            if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
                text = following.value if isinstance(following, ast.Expr) else None
                value = text.value if isinstance(text, ast.Constant) and isinstance(text.value, str) else None
                yield f"{node.name}.{item.target.id}", item, value


def mistakes(source: str) -> list[str]:
    found = []
    for name, item, docstring in fields(source):
        words = set(re.findall(r"\w+", ast.unparse(item.annotation)))
        number = bool(words & REAL) or ("int" in words and UNIT_IN_NAME.search(name) is not None)
        if docstring is None:
            found.append(f"{name}: no attribute docstring")
        elif number and "dict" not in words and not (UNIT.search(docstring) or SHAPE.search(docstring)):
            found.append(f"{name}: a number without [unit]")
    return found


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_field_has_a_docstring_with_its_unit(path: Path) -> None:
    assert mistakes(path.read_text(encoding="utf-8")) == []


def test_the_check_itself_finds_what_is_missing() -> None:
    source = '''
@dataclass(frozen=True)
class Example:
    mass: float
    """[kg]."""
    span: float
    """Tip to tip."""
    rate: NDArray[np.float64]
    """(n, 3) [rad/s] B."""
    time_us: int
    """Model time."""
    count: int
    name: str
    """Short name."""
class Sample(NamedTuple):
    gyro_B: Vector
    """Measured."""
'''
    assert mistakes(source) == [
        "Example.span: a number without [unit]",
        "Example.time_us: a number without [unit]",
        "Example.count: no attribute docstring",
        "Sample.gyro_B: a number without [unit]",
    ]
