"""A controller object, sample by sample: what a user's object must do, and the checks around it."""

import importlib
import importlib.util
import inspect
import math
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from firmware_model.config.validation import sanitize_line
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import Vector
from gustproof.flight.controllers.time_limit import TimeLimitExceeded, time_limit
from gustproof.flight.controllers.user_controller import ControllerKind, UserController
from gustproof.law.form import Output
from gustproof.types import Array

STEP_LIMIT_S = 5.0
"""[s] wall time of a step in this process after which the controller counts as hung."""
MAKE_LIMIT_S = 60.0
"""[s] wall time in which a controller must be made."""


class Stepper(Protocol):
    """A controller object: what `make()` of a user's file returns."""

    def reset(self) -> None:
        """Return to the state of the first sample."""

    def step(self, gyro: Array, reference: Array, force: Array, dt: float) -> Any:
        """Return three torques [N m] B for a sample.

        It gets rates [rad/s] B, attitude to hold [rad] roll, pitch, yaw, specific force [m/s^2] B, each (3,), and the
        sample time [s].
        """


class StepFault(Enum):
    """Ways in which a step fails."""

    RAISED = "raised"
    """It raised an error, or returned something else than three numbers."""
    NOT_FINITE = "not_finite"
    """It returned NaN or an infinite number."""
    HUNG = "hung"
    """It took longer than `STEP_LIMIT_S`."""


class StepError(Exception):
    """A controller failed in flight; the text is one line: controller, cause, place."""

    def __init__(self, fault: StepFault, text: str) -> None:
        super().__init__(sanitize_line(text))
        self.fault = fault


class CheckedStepper:
    """A user's controller, whose failures become a `StepError` each."""

    def __init__(self, name: str, stepper: Stepper, output: Output = Output.TORQUE, dt: float | None = None) -> None:
        self._stepper = stepper
        self.output = output
        """Quantity that it commands."""
        self.dt = dt
        """[s] sample time; `None` for that of the flight."""
        self.name = name
        """Name in texts."""
        self.order, self.is_scheduled = 0, False
        """No states that others could keep, and no attitude estimate that they could correct."""
        self._calls, self._busy = 0, False

    def reset(self) -> None:
        """Return to the state of the first sample."""
        self._call("reset()", self._stepper.reset)

    def step(self, gyro: Array, reference: Array, force: Array, dt: float) -> Vector:
        """Return the torques [N m] B, checked; see `Stepper.step`."""
        torque = self._call("step()", lambda: np.asarray(self._stepper.step(gyro, reference, force, dt)))
        if torque.shape != (3,) or torque.dtype.kind not in "fiu":
            found = f"shape {torque.shape} of {torque.dtype}"
            raise StepError(
                StepFault.RAISED, f"controller '{self.name}': step() returned {found}, must be three numbers"
            )
        x, y, z = torque.tolist()
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            raise StepError(StepFault.NOT_FINITE, f"controller '{self.name}': step() returned {x:g}, {y:g}, {z:g} N m")
        return float(x), float(y), float(z)

    def _call(self, what: str, call: Callable[[], Any]) -> Any:
        self._calls, self._busy = self._calls + 1, True
        try:
            result = call()
        except (Exception, SystemExit) as error:
            raise StepError(
                StepFault.RAISED, f"controller '{self.name}': {what} raised {describe_error(error)}"
            ) from error
        self._busy = False
        return result

    @contextmanager
    def limit_time(self) -> Iterator[None]:
        """Raise a `StepError` in the block once a call takes longer than `STEP_LIMIT_S`, see `time_limit`."""
        try:
            with time_limit(STEP_LIMIT_S, lambda: self._calls if self._busy else time.monotonic_ns()):
                yield
        except TimeLimitExceeded:
            raise StepError(
                StepFault.HUNG, f"controller '{self.name}': a step takes longer than {STEP_LIMIT_S:g} s"
            ) from None


def make_stepper(entry: UserController, vehicle: Vehicle, dt: float | None = None) -> CheckedStepper:
    """Make a user's controller for a vehicle as its user knows it.

    The maker gets the vehicle if it takes an argument. An object of Python has the sample time `dt` [s], a library its
    own. Each call makes a new controller; the module is loaded once.

    Raises
    ------
    ConfigError
        If its user did not name it, it can't be loaded, its maker fails, or it is a program.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> from gustproof import load_vehicle, make_stepper, parse_controller
    >>> text = '''
    ... class Damper:
    ...     def reset(self):
    ...         pass
    ...
    ...     def step(self, gyro, reference, force, dt):
    ...         return -0.1 * gyro
    ...
    ...
    ... make = Damper
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "damper.py"
    ...     _ = file.write_text(text)
    ...     damper = make_stepper(parse_controller(f"{file}:make"), load_vehicle("paper"))
    >>> damper.step(np.array([1.0, 0.0, 0.0]), np.zeros(3), np.zeros(3), 0.004)[0]
    -0.1
    """
    entry.check_given()
    if entry.kind is ControllerKind.PROGRAM:
        raise ConfigError(f"controller '{entry.source}': is a program, which flies by MAVLink alone")
    if entry.kind is ControllerKind.LIBRARY:
        from gustproof.flight.controllers.library import LibraryStepper, load_library

        library = load_library(entry)
        return CheckedStepper(entry.name, LibraryStepper(library), library.output, library.dt)
    place, _, name = entry.source.rpartition(":")
    module = _load(entry.source, place, entry.digest)
    maker = getattr(module, name, None)
    if not callable(maker):
        raise ConfigError(f"controller '{entry.source}': {place} has no function '{name}'")
    stepper = _call(entry.source, f"{name}()", maker, *([vehicle] if _takes_vehicle(maker) else []))
    for method in ("reset", "step"):
        if not callable(getattr(stepper, method, None)):
            kind = type(stepper).__name__
            raise ConfigError(f"controller '{entry.source}': {name}() returned a {kind} without {method}()")
    return CheckedStepper(entry.name, stepper, dt=dt)


def describe_error(error: BaseException) -> str:
    """Return an error in one line: kind, text, and the place in the source where it was raised."""
    text = traceback.format_exception_only(error)[-1].strip()
    if isinstance(error, SyntaxError):
        return f"{text} ({Path(error.filename or '').name}:{error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    return f"{text} ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else text


@lru_cache(maxsize=32)
def _load(source: str, place: str, digest: str) -> ModuleType:  # once for each content
    if not place.endswith(".py"):
        module: ModuleType = _call(source, "import", importlib.import_module, place)
        return module
    path = Path(place).resolve()
    if str(path.parent) not in sys.path:  # for modules beside it, as when Python runs the file
        sys.path.append(str(path.parent))
    name = f"_entry_{digest}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"controller '{source}': can't be imported")
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    _call(source, "import", spec.loader.exec_module, module)
    return module


def _takes_vehicle(maker: Callable[..., Any]) -> bool:
    """Return whether a maker takes an argument: one without default, or one named `vehicle`."""
    try:
        first = next(iter(inspect.signature(maker).parameters.values()), None)
    except (TypeError, ValueError):  # a function of C that does not tell
        return False
    if first is None or first.kind not in (first.POSITIONAL_ONLY, first.POSITIONAL_OR_KEYWORD):
        return False
    return first.default is first.empty or first.name == "vehicle"


def _call(source: str, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a user's function before the flight.

    Raises
    ------
    ConfigError
        If it raises, or takes longer than `MAKE_LIMIT_S`.
    """
    try:
        with time_limit(MAKE_LIMIT_S):
            return function(*arguments)
    except TimeLimitExceeded:
        raise ConfigError(f"controller '{source}': {what} takes longer than {MAKE_LIMIT_S:g} s") from None
    except (Exception, SystemExit) as error:
        raise ConfigError(sanitize_line(f"controller '{source}': {what} raised {describe_error(error)}")) from error
