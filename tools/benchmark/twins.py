"""The same flight as a C program, scalar and SIMD, which counts only if its result is ours."""

import ctypes
import platform
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_model.autopilot.parameters import published_limit
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.physics.aerodynamics import AirParams
from firmware_model.sim import layout
from firmware_model.sim.state import initial_state
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import Law
from gustproof.law.step import sparse_law

Array = NDArray[np.float64]
_SUMMATION = 1e-12  # [-] relative effect of another order of summation on a sum of squares
_SOURCE = Path(__file__).parent / "twin.c"
_OPTIONS = ("-O3", "-march=native", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
_WIDE = ("-mprefer-vector-width=512",) if platform.machine() in ("x86_64", "AMD64") else ()
"""As ours, for C compilers too prefer half of the registers of AVX-512."""


class Twin:
    """The C program for `width` flights at once."""

    def __init__(self, folder: Path, scenario: Scenario, law: Law, vehicle: Vehicle, width: int) -> None:
        compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
        if compiler is None:
            raise FileNotFoundError("no C compiler")
        self.width, self._scenario, self._law, self._vehicle = width, scenario, law, vehicle
        gust_gain = layout.AIR + AirParams._fields.index("gust_gain")
        defined = {
            "W": width,
            "ORDER": law.order,
            "BODY": layout.BODY,
            "DRYDEN": layout.DRYDEN,
            "GYRO": layout.GYRO,
            "GUST_GAIN": gust_gain,
            "X_BODY": layout.X_BODY,
            "X_DRYDEN": layout.X_DRYDEN,
        }
        library = folder / f"twin{width}.so"
        options = [*_OPTIONS, *_WIDE, *(f"-D{name}={value}" for name, value in defined.items())]
        subprocess.run([compiler, *options, str(_SOURCE), "-o", str(library), "-lm"], check=True, capture_output=True)
        self._fly = ctypes.CDLL(str(library)).fly
        self._sums = sparse_law(law)
        self._limit = np.array(published_limit(vehicle))

    def prepare(self, seeds: list[int]) -> Callable[[], tuple[Array, Array]]:
        """Return a function that flies, with initial states made here, outside the measurement.

        It returns attitude and rates (7, n) at the last sample, and the sum of the squares of the torques (n,).
        """
        batches = [self._batch(seeds[i : i + self.width]) for i in range(0, len(seeds), self.width)]

        def fly() -> tuple[Array, Array]:
            flown = [batch() for batch in batches]
            return np.hstack([last for last, _ in flown])[:, : len(seeds)], np.concatenate([sums for _, sums in flown])

        return fly

    def _batch(self, seeds: list[int]) -> Callable[[], tuple[Array, Array]]:
        full = seeds + seeds[-1:] * (self.width - len(seeds))
        states = [initial_state(self._vehicle, self._scenario, seed) for seed in full]
        params, start = (np.array([getattr(one, name) for one in states]).T.copy() for name in ("params", "state"))
        drawn, last, torque = np.array(full, dtype=np.uint32), np.empty((7, self.width)), np.empty(self.width)
        scenario = self._scenario
        substeps = scenario.physics_rate_hz // scenario.control_rate_hz
        law = self._sums
        limits = np.concatenate([law.limits, law.rate_limits, law.attitude_limits])
        arrays = (params, start, drawn, law.ends, law.terms, limits, self._limit, last, torque)
        dt = ctypes.c_double(scenario.sample_us * 1e-6 / substeps)

        def fly() -> tuple[Array, Array]:
            self._fly(scenario.samples, substeps, dt, *(array.ctypes.data_as(ctypes.c_void_p) for array in arrays))
            return last.copy(), torque.copy()

        return fly


def difference(twin: Twin, scenario: Scenario, law: Law, vehicle: Vehicle) -> float:
    """Return the largest relative difference between the twin's flights and ours: 0 if all bits are equal."""
    seeds = [1, 2, 3]
    last, torque = twin.prepare(seeds)()
    worst = 0.0
    for i, seed in enumerate(seeds):
        records = fly_direct(scenario, law, vehicle=vehicle, seed=seed)
        ours = np.concatenate([records["q_NB"][-1], records["omega_B"][-1]])
        worst = max(worst, float(np.max(np.abs(last[:, i] - ours) / np.abs(ours))))
        asked = float(np.sum(records["torque_command_B"] ** 2))
        worst = max(worst, abs(torque[i] / asked - 1.0) * (abs(torque[i] / asked - 1.0) > _SUMMATION))
    return worst
