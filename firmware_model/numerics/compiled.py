"""How numerical code is compiled: always without fastmath, so that every route gives the same bits.

A `kernel` is physics on scalars; it is inlined wherever it is used, and to Python it is plain Python. A `compiled`
function is an entry point that Python calls; its machine code is kept on disk.
"""

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import types
from numba.extending import intrinsic, overload, register_jitable

_CACHE_LINE = 64  # [B]
Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile scalar physics to be inlined into the entry point that uses it.

    Wrappers for calls from Python would take 40 % of the time to compile.
    """
    inlined = register_jitable(forceinline=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
    return cast(Function, inlined(function))


def align_stack() -> None:
    """Let the stack of the entry point that calls this begin at a cache line; to Python it does nothing.

    LLVM keeps what registers have no room for on the stack, wherever that is: a register of 64 bytes that lies across
    two lines takes twice the time, and a rigid body's step has a hundred of them.
    """


def _stack_alignment(_: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        attributes = builder.function.attributes
        attributes.alignstack = _CACHE_LINE
        attributes.add("nounwind")  # an alignment alone is not written; compiled code never unwinds
        return context.get_dummy_value()

    return types.void(), generate


_set_stack_alignment = intrinsic(_stack_alignment)
overload(align_stack, inline="always")(lambda: lambda: _set_stack_alignment())


def compiled(function: Function) -> Function:
    """Compile an entry point and keep its machine code between processes.

    It makes no array: without those nothing has to count who holds one, which took a third of the time of a step.

    numba renews its cache only when the file of the entry point itself changes. The kernels that are inlined into it
    live in other files, so the stamp covers every source that a kernel can come from.
    """
    entry = numba.njit(cache=True, error_model="numpy", _nrt=False)(function)
    if cache := getattr(entry, "_cache", None):
        cache._cache_file._source_stamp = _source_stamp(_find_package(Path(function.__code__.co_filename)))
    return cast(Function, entry)


def _find_package(source: Path) -> Path:
    """Return the folder of the top-level package that a source belongs to."""
    return max(
        (parent for parent in source.parents if (parent / "__init__.py").exists()),
        key=lambda p: -len(p.parts),
        default=source.parent,
    )


@cache
def _source_stamp(package: Path) -> tuple[tuple[str, int, int], ...]:
    """Return path, change time [ns] and size of each source that an entry point of `package` may inline."""
    rooms = {room for top in {_find_package(Path(__file__)), package} for room in _find_kernel_folders(top)}
    sources = sorted(source for room in rooms for source in room.glob("*.py"))
    return tuple((str(source), source.stat().st_mtime_ns, source.stat().st_size) for source in sources)


def _find_kernel_folders(package: Path) -> set[Path]:
    """Return the folders of `package` that hold kernels, or values that those import and so are compiled in."""
    rooms = set()
    for source in package.rglob("*.py"):
        text = source.read_text(encoding="utf-8")
        if "numerics.compiled import" in text:
            rooms.add(source.parent)
            for module in re.findall(rf"^from {package.name}((?:\.\w+)*)", text, re.MULTILINE):
                path = package.joinpath(*module.split(".")[1:])
                rooms.add(path if path.is_dir() else path.parent)
    return rooms
