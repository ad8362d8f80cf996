"""Compile numerical code, always without fastmath, so that every route gives the same bits.

A `kernel` is physics on scalars. It is inlined wherever it is used, and stays plain Python for Python. A `compiled`
function is an entry point that Python calls; its machine code is kept on disk.
"""

import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba.core import event, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.extending import intrinsic, overload, register_jitable

from firmware_model.numerics.kept_code import CodeCache, KeptCode

_CACHE_LINE = 64  # [B]
Function = TypeVar("Function", bound=Callable[..., Any])


def _compile_part(typing: Any, target: Any, _: Any, *rest: Any) -> Any:
    """Return numba's compiler for a kernel, whose code counts only in the entry points that inline it.

    Numba would optimise the code of each kernel, with all that it inlines, and then make machine code of it. That is
    half of the time to compile.
    """
    return Compiler(typing, target, _Part(target.codegen(), "kernel"), *rest)


_Part: Any = type(
    "_Part",
    (JITCodeLibrary,),
    {
        "_optimize_final_module": lambda _: None,
        "_finalize_final_module": lambda self: setattr(self, "_finalized", True),
        "get_pointer_to_function": lambda *_: 0,
        # without machine code, there is no place for the Python environment either
        "codegen": property(lambda self: self),
        "set_env": lambda *_: None,
    },
)

# Wrappers for calls from Python would take 40 % of the time to compile.
_OPTIONS = {
    "forceinline": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": _compile_part,
}
INLINED: dict[str, Any] = {"jit_options": _OPTIONS, "strict": False}
"""Options of `overload` for a function that is inlined into the entry point that uses it."""


def kernel(function: Function) -> Function:
    """Compile scalar physics to be inlined into the entry point that uses it."""
    return cast(Function, register_jitable(**_OPTIONS)(function))


def expect_simd() -> None:
    """Compile the calling entry point for loops over flights; in Python do nothing.

    Its arrays must not overlap: LLVM then need not find that out before each loop. It may use registers as wide as a
    cache line, if there are any. It prefers half of that, as the first processors with such registers lowered their
    clock for them. And it spills registers to the stack at any address: one that lies across two lines takes twice the
    time, so the stack is aligned.
    """


def _simd_attributes(_: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        attributes = builder.function.attributes
        attributes.alignstack = _CACHE_LINE
        attributes.add("nounwind")  # llvmlite drops an alignment that stands alone; compiled code never unwinds
        set.add(attributes, f'"prefer-vector-width"="{8 * _CACHE_LINE}"')  # llvmlite's own `add` knows no such name
        for argument in builder.function.args:
            if isinstance(argument.type, ir.PointerType):
                argument.add_attribute("noalias")
        return context.get_dummy_value()

    return types.void(), generate


_set_simd_attributes = intrinsic(_simd_attributes)
overload(expect_simd, inline="always")(lambda: lambda: _set_simd_attributes())


def compiled(function: Function) -> Function:
    """Compile an entry point and keep its machine code between processes.

    Compiled without numba's runtime: entry points allocate nothing, and without reference counts a step takes a
    third less time.

    numba renews its cache only when the file of the entry point itself changes. Inlined kernels live in other files,
    so the stamp covers every source that a kernel can come from. Where no folder can be written, nothing is kept.
    """
    entry: Any = numba.njit(error_model="numpy", _nrt=False)(function)
    if hasattr(entry, "_cache"):  # without compiler it is the function
        with suppress(RuntimeError):  # no folder
            entry._cache = CodeCache(function)
            entry._cache.set_stamp(_source_stamp(_find_package(Path(function.__code__.co_filename))))
    return cast(Function, entry)


class _Work(event.Listener):  # type: ignore[misc]  # numba has no types
    """Count of entry points that are compiled now; one may need another."""

    count = 0

    def on_start(self, _: Any) -> None:
        self.count += 1

    def on_end(self, _: Any) -> None:
        self.count -= 1


_work = _Work()
event.register("numba:compile", _work)


def is_compiling() -> bool:
    """Return whether machine code is made now, in any thread of this process; it is not while code is loaded."""
    return _work.count > 0


def _find_package(source: Path) -> Path:
    """Return the folder of a source's top-level package."""
    return max(
        (parent for parent in source.parents if (parent / "__init__.py").exists()),
        key=lambda p: -len(p.parts),
        default=source.parent,
    )


@cache
def _source_stamp(package: Path) -> tuple[tuple[str, int, int], ...]:
    """Return path, change time [ns] and size of each source that an entry point of `package` may inline."""
    folders = {folder for top in {_find_package(Path(__file__)), package} for folder in _find_kernel_folders(top)}
    sources = sorted(source for folder in folders for source in folder.glob("*.py"))
    return tuple((str(source), source.stat().st_mtime_ns, source.stat().st_size) for source in sources)


def _find_kernel_folders(package: Path) -> set[Path]:
    """Return the folders of `package` with kernels, and with modules that kernels import constants from."""
    folders = set()
    for source in package.rglob("*.py"):
        text = source.read_bytes()
        if b"numerics.compiled import" in text:
            folders.add(source.parent)
            for module in re.findall(rf"^from {package.name}((?:\.\w+)*)".encode(), text, re.MULTILINE):
                path = package.joinpath(*module.decode().split(".")[1:])
                folders.add(path if path.is_dir() else path.parent)
    return folders


def find_cache(entry: Any) -> KeptCode | None:
    """Return where the machine code of an entry point is kept; `None` if it is not compiled, or kept nowhere."""
    cache = getattr(entry, "_cache", None)
    return cache.kept if isinstance(cache, CodeCache) else None
