"""RotorPy, a simulator from the package index: its Hummingbird, commanded by rotor speeds.

Its axes are forward, left, up, and north, west, up; ours are forward, right, down, and north, east, down.

References
----------
S. Folk, J. Paulos, V. Kumar, RotorPy: A Python-based Multirotor Simulator with Aerodynamics for Education and
Research, 2023.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from firmware_model.errors import ConfigError
from gustproof.studies.audit.simulator import (
    HEIGHT,
    Airframe,
    Array,
    FlightStart,
    NotReachable,
    RequestedAir,
    Simulator,
    TrueMotion,
    to_vector,
)
from gustproof.studies.audit.turbulence import expected_turbulence

_FLIP = np.array((1.0, -1.0, -1.0))  # between their axes and ours, in both frames


def load_rotorpy() -> Simulator:
    """Return the adapter.

    Raises
    ------
    ConfigError
        If RotorPy is not installed.
    """
    try:
        return RotorPy(version("rotorpy"))
    except PackageNotFoundError:
        raise ConfigError("audit rotorpy: it is not installed: pip install 'gustproof[rotorpy]'") from None


class RotorPy(Simulator):
    """RotorPy's forward dynamics and winds. It draws from numpy's one stream of random numbers, seeded here."""

    def __init__(self, number: str) -> None:
        self.name = f"RotorPy {number}"
        self._params = import_module("rotorpy.vehicles.hummingbird_params").quad_params

    @property
    def airframe(self) -> Airframe:
        """Vehicle that RotorPy states; a command is a share of the largest rotor speed, thrust goes with its square."""
        given = self._params
        speed = given["rotor_speed_max"]
        hubs = [to_vector(_FLIP * hub) for hub in given["rotor_pos"].values()]
        return Airframe(
            mass=given["mass"],
            inertia_B=(given["Ixx"], given["Iyy"], given["Izz"]),
            position_B=tuple(hubs),
            # A rotor that pulls its vehicle counter-clockwise turns clockwise.
            spin=tuple(-int(direction) for direction in given["rotor_directions"]),
            drag_ratio=given["k_m"] / given["k_eta"],
            thrust_max=given["k_eta"] * speed**2,
            thrust_square=1.0,
            actuator_lag=given["tau_m"],
        )

    def reset(self, seed: int, dt: float, air: RequestedAir, start: FlightStart) -> TrueMotion:
        """Begin a free flight."""
        np.random.seed(seed)  # noqa: NPY002 - it has no generator of its own
        self._dt, self._time, self._wind = dt, 0.0, _wind(dt, air)
        self._state = {
            "x": np.array((0.0, 0.0, HEIGHT)),
            "v": np.zeros(3),
            "q": np.array((0.0, 0.0, 0.0, 1.0)),
            "w": _FLIP * start.omega_B,
            "wind": np.zeros(3),
            "rotor_speeds": start.rotors * self._params["rotor_speed_max"],
        }
        self._vehicle = import_module("rotorpy.vehicles.multirotor").Multirotor(self._params, self._state)
        return self._motion()

    def step(self, rotors: Array) -> TrueMotion:
        """Fly a step, with the wind of its start."""
        self._state["wind"] = self._wind.update(self._time, self._state["x"])
        control = {"cmd_motor_speeds": rotors * self._params["rotor_speed_max"]}
        self._state = self._vehicle.step(self._state, control, self._dt)
        self._time += self._dt
        return self._motion()

    def sample_air(self, seed: int, dt: float, air: RequestedAir, samples: int) -> Array:
        """Return its wind at one place."""
        np.random.seed(seed)  # noqa: NPY002 - it has no generator of its own
        wind, place = _wind(dt, air), np.array((0.0, 0.0, HEIGHT))
        return np.array([_FLIP * wind.update(i * dt, place) for i in range(samples)])

    def _motion(self) -> TrueMotion:
        x, y, z, w = self._state["q"].tolist()
        velocity, rate = (to_vector(_FLIP * self._state[name]) for name in ("v", "w"))
        return TrueMotion(velocity, (w, x, -y, -z), rate)


def _wind(dt: float, air: RequestedAir) -> Any:
    """Return its wind for an air: a constant one, or its Dryden model with the intensities that ours would have."""
    mean = _FLIP * air.wind_N
    if air.turbulence is None:
        return import_module("rotorpy.wind.default_winds").ConstantWind(*mean)
    try:
        gusts = import_module("rotorpy.wind.dryden_winds")
    except (ImportError, NameError) as error:  # it needs a package that it does not require
        raise NotReachable(f"its Dryden model does not load: {error}") from None
    return gusts.DrydenGust(dt=dt, avg_wind=mean, sig_wind=expected_turbulence().intensity, altitude=HEIGHT)
