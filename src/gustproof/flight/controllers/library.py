"""Controllers in C: shared libraries with the functions and facts that `gustproof export -o law.c` writes."""

import firmware_model.numerics  # noqa: F401  # before numba, which would read a file of the current folder

# isort: split
import ctypes
import math
import re
from collections.abc import Container
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from firmware_model.config.validation import printable
from firmware_model.errors import ConfigError
from firmware_model.numerics.compiled import INLINED
from gustproof.flight.controllers.user_controller import UserController
from gustproof.law.form import GYRO_REFERENCE_SIZE, Output
from gustproof.law.step import MEASURED_SIZE
from gustproof.types import Array

_FACTS = re.compile(rb"([A-Za-z]\w*)_facts\0")
_HEAD = ctypes.c_int * 5
_ALLOWED: dict[str, Container[int]] = {
    "states": range(1, 4097),
    "measured": (GYRO_REFERENCE_SIZE, MEASURED_SIZE),
    "bytes": (4, 8),
    "rates": (0, 1),
    "reserved": range(4097),
}
"""Numbers at the start of the facts, in their order; the last is not used, and 0 in what is exported."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Library:
    """A controller in a loaded library: what its `<name>_facts` tell, and addresses of its functions."""

    name: str
    """Name of the law."""
    order: int
    """Count of states."""
    uses_accelerometer: bool
    """True if it reads the specific force."""
    is_single: bool
    """True if its numbers are in single precision."""
    output: Output
    """Quantity that it commands."""
    dt: float
    """[s] sample time."""
    initialize: int
    """Address of `<name>_init`."""
    step: int
    """Address of `<name>_step`."""

    def initial_state(self) -> NDArray[Any]:
        """Return the states (n,) of the first sample."""
        x = np.zeros(self.order, dtype=np.float32 if self.is_single else np.float64)
        ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self.initialize)(x.ctypes.data)
        return x


class LibraryStepper:
    """The controller of a library as an object of Python, see `gustproof.flight.controllers.stepper.Stepper`."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self.reset()

    def reset(self) -> None:
        """Return to the state of the first sample."""
        self._x = self._library.initial_state()
        self._y, self._command = np.zeros(MEASURED_SIZE, self._x.dtype), np.zeros(3, self._x.dtype)

    def step(self, gyro: Array, reference: Array, force: Array, _dt: float) -> NDArray[Any]:
        """Return the command for a sample."""
        self._y[:3], self._y[3:6], self._y[6:] = gyro, reference, force
        call_step(self._library.step, self._x, self._y, self._command)
        return self._command


def load_library(entry: UserController) -> Library:
    """Load the library of a user's controller.

    Raises
    ------
    ConfigError
        If its user did not name it, it can't be loaded, or does not tell the facts of one law.
    """
    entry.check_given()
    return _load(entry)


@lru_cache(maxsize=32)
def _load(entry: UserController) -> Library:
    path, where = Path(entry.source).resolve(), f"controller '{entry.source}'"
    try:
        loaded = ctypes.CDLL(str(path))
    except OSError as error:
        raise ConfigError(f"{where}: {printable(str(error))}") from None
    names = {name.decode() for name in _FACTS.findall(path.read_bytes())}
    prefixes = sorted(name for name in names if hasattr(loaded, f"{name}_facts"))
    if len(prefixes) != 1:
        found = f"facts of {', '.join(prefixes)}" if prefixes else "no <name>_facts"
        raise ConfigError(f"{where}: has {found}; it must have those of one law, as gustproof export -o writes them")
    return _read(loaded, prefixes[0], where)


def _read(loaded: ctypes.CDLL, prefix: str, where: str) -> Library:
    def address(name: str) -> int:
        try:
            return ctypes.cast(getattr(loaded, f"{prefix}_{name}"), ctypes.c_void_p).value or 0
        except AttributeError:
            raise ConfigError(f"{where}: has no {prefix}_{name}") from None

    states, measured, size, rates, _ = head = list(_HEAD.in_dll(loaded, f"{prefix}_facts"))
    if not all(number in allowed for number, allowed in zip(head, _ALLOWED.values(), strict=True)):
        facts = ", ".join(f"{name} {number}" for name, number in zip(_ALLOWED, head, strict=True))
        raise ConfigError(f"{where}: {prefix}_facts can't be: {facts}")
    dt, name = _read_rest(loaded, prefix, single=size == 4)
    if not (math.isfinite(dt) and dt > 0.0):
        raise ConfigError(f"{where}: {prefix}_facts can't be: dt {dt}")
    return Library(
        name=printable(name) or prefix,
        order=states,
        uses_accelerometer=measured == MEASURED_SIZE,
        is_single=size == 4,
        output=(Output.TORQUE, Output.RATES)[rates],
        dt=dt,
        initialize=address("init"),
        step=address("step"),
    )


def _read_rest(loaded: ctypes.CDLL, prefix: str, *, single: bool) -> tuple[float, str]:
    """Return sample time [s] and name among the facts."""
    real = ctypes.c_float if single else ctypes.c_double

    class Facts(ctypes.Structure):
        _fields_ = (("head", _HEAD), ("dt", real), ("limits", real * 3), ("name", ctypes.c_char_p))

    facts = Facts.in_dll(loaded, f"{prefix}_facts")
    dt = float(str(np.float32(facts.dt))) if single else float(facts.dt)  # the decimal that was meant
    return dt, (facts.name or b"").decode("utf-8", "replace")


def call_step(address: int, x: NDArray[Any], y: NDArray[Any], command: NDArray[Any]) -> None:
    """Call the C function at `address` with pointers to the first numbers of three arrays, in kernels too."""
    pointer = ctypes.c_void_p
    ctypes.CFUNCTYPE(None, pointer, pointer, pointer)(address)(x.ctypes.data, y.ctypes.data, command.ctypes.data)


def _call(_: Any, address: Any, x: Any, y: Any, command: Any) -> Any:
    """Return the typing of the intrinsic: the address is a number at run time, so that machine code can be kept."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args[1:]
        data = [
            builder.bitcast(context.make_array(kind)(context, builder, value).data, ir.IntType(8).as_pointer())
            for kind, value in zip(kinds, arguments[1:], strict=True)
        ]
        function = ir.FunctionType(ir.VoidType(), [ir.IntType(8).as_pointer()] * 3)
        builder.call(builder.inttoptr(arguments[0], function.as_pointer()), data)
        return context.get_dummy_value()

    return types.void(types.intp, x, y, command), generate


_call_pointer = intrinsic(_call)
overload(call_step, **INLINED)(
    lambda _a, _x, _y, _c: lambda address, x, y, command: _call_pointer(address, x, y, command)
)
