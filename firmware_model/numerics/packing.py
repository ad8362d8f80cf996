"""List the few numbers that take a longer way, by AVX-512's own instruction where the processor has it."""

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from firmware_model.numerics.compiled import INLINED, kernel
from firmware_model.numerics.soa import spread

Array = NDArray[np.float64]
Indices = NDArray[np.int32]
_EIGHT = 8
"""Numbers in a register of AVX-512."""
_NUMBER = 8  # [B]


@kernel
def is_outside(value: float, least: int, breadth: int) -> bool:
    """Return whether the bits of `value`, as an integer, are outside `least` to `least` + `breadth`."""
    return bool(np.uint64(np.float64(value).view(np.int64) - least) > np.uint64(breadth))


def list_outside(values: Array, least: int, breadth: int, indices: Indices) -> int:
    """Write the index of each number of `values` that `is_outside`; return their count.

    `indices` has at least the size of `values`. What follows those counted is of no use.
    """
    count = 0
    for i in range(values.size):
        indices[count] = i
        count += is_outside(values[i], least, breadth)
    return count


def _list_eight(_: Any, values: Any, at: Any, least: Any, breadth: Any, indices: Any, count: Any) -> Any:
    """Return the typing of the intrinsic that lists those of eight numbers from `at` on, after `count` of others."""
    half, word = ir.IntType(32), ir.IntType(64)
    words, flags = ir.VectorType(word, _EIGHT), ir.VectorType(ir.IntType(1), _EIGHT)
    name, kind = "llvm.x86.avx512.mask.compress.v8i64", ir.FunctionType(words, (words, words, flags))

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        source, at, least, breadth, target, count = arguments
        source, target = (
            context.make_array(kind)(context, builder, array).data
            for kind, array in ((values, source), (indices, target))
        )
        value = builder.load(builder.bitcast(builder.gep(source, [at]), words.as_pointer()), align=_NUMBER)
        outside = builder.icmp_unsigned(
            ">", builder.sub(value, spread(builder, least, words)), spread(builder, breadth, words)
        )
        numbered = builder.add(spread(builder, at, words), ir.Constant(words, list(range(_EIGHT))))
        compress = builder.module.declare_intrinsic(name, (), kind)
        listed = builder.trunc(builder.call(compress, (numbered, numbered, outside)), ir.VectorType(half, _EIGHT))
        start = builder.bitcast(builder.gep(target, [count]), listed.type.as_pointer())
        builder.store(listed, start, align=_NUMBER // 2)
        found = builder.ctpop(builder.bitcast(outside, ir.IntType(_EIGHT)))
        return builder.add(count, builder.zext(found, word))

    return types.int64(values, types.int64, types.int64, types.int64, indices, types.int64), generate


_list_from = intrinsic(_list_eight)


def _overload_list(*_: Any) -> Callable[..., int]:
    def list_by_eight(values: Array, least: int, breadth: int, indices: Indices) -> int:
        count, end = 0, values.size - values.size % _EIGHT
        for i in range(0, end, _EIGHT):
            count = _list_from(values, i, least, breadth, indices, count)
        for i in range(end, values.size):
            indices[count] = i
            count += is_outside(values[i], least, breadth)
        return max(count, 0)  # tells the compiler that indices made of it are not negative

    return list_by_eight if "+avx512f" in cpu_target.target_context.codegen().magic_tuple()[2] else list_outside


overload(list_outside, **INLINED)(_overload_list)
