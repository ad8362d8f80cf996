import math
import signal
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from functools import cache, partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import Vehicle, load_vehicle
from firmware_model.process import realtime
from firmware_model.recording.journal import record_type
from gustproof.cli import options
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import Flight, FlightPlan
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.law.form import Law, Output, Provenance, RateLimit, Schedule, load_law
from gustproof.logs.identify.identification import AxisEstimate, Identification, Interval
from gustproof.logs.read.flight_log import CommandUnit, FlightLog, LogSignal
from gustproof.types import Records

UNITS = Path(__file__).parent
WAITING = (
    UNITS.with_name("conformance"),
    UNITS / "firmware_model" / "external",
    UNITS / "flight/routes/test_external.py",
)


def pytest_collection_modifyitems(items):
    """Begin with what waits for clocks in turns with searches, which take a worker a minute: no core is left alone."""
    waiting = dict.fromkeys(item.path for item in items if _is_waiting(item.path))
    searching = dict.fromkeys(item.path for item in items if item.get_closest_marker("slow"))
    for path in waiting:
        searching.pop(path, None)
    turns = {path: turn for turn, path in enumerate(path for pair in zip_longest(waiting, searching) for path in pair)}
    items.sort(key=lambda item: turns.get(item.path, len(turns)))


@cache
def _is_waiting(path):
    return any(map(path.is_relative_to, WAITING))


@pytest.fixture(autouse=True, scope="session")
def slow_machine_is_not_told_of() -> Iterator[None]:
    """Print no lines of progress: what a command says does not depend on the load of the machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(options, "_FIRST_LINE_S", 3600.0)
        yield


@pytest.fixture
def leaves() -> Callable[..., Iterator[tuple[tuple[str | int, ...], Any]]]:
    """Return what yields path and value of each number and text of a document."""
    return _leaves


@pytest.fixture
def changed() -> Callable[..., dict[str, Any]]:
    """Return what copies a document with `value` at a path, by default with its last bit or letter changed."""
    return _changed


@pytest.fixture
def make_law() -> Callable[..., Law]:
    """Return what makes a law of random numbers, of `n` states and six or eight measurements."""
    return _law


@pytest.fixture
def turn() -> Callable[..., Law]:
    """Return what gives a law a schedule of random numbers of some size."""
    return _schedule


def _schedule(law: Law, size: float = 0.3) -> Law:
    rng, (n, m) = np.random.default_rng(7), law.B.shape
    shapes = {"J": (4, n), "K": (4, m), "L": (4, 4), "P": (3, 4), "Q": (n, 4)}
    parts = {name: size * rng.uniform(-1.0, 1.0, shape) for name, shape in shapes.items()}
    limits, parameters = np.array([0.3, 0.2, 0.5, 0.5]), ("phi", "theta", "r", "r")
    return replace(law, schedule=Schedule(parameters=parameters, limits=limits, **parts))


def _law(n: int = 7, *, scheduled: bool = True, seed: int = 1, measured: int = 6, limited: bool = False) -> Law:
    rng = np.random.default_rng(seed)
    return Law(
        name="test",
        A=0.3 * rng.normal(size=(n, n)) / math.sqrt(n),
        B=rng.normal(size=(n, measured)),
        C=rng.normal(size=(3, n)),
        D=rng.normal(size=(3, measured)),
        G=0.1 * rng.normal(size=(n, 3)) if scheduled else np.zeros((n, 3)),
        H=rng.normal(size=(n, 3)),
        dt=0.004,
        limits=np.array([0.5, 1.0, 2.0]),
        output=Output.TORQUE,
        provenance=Provenance(design="random", vehicle="none", parameters={"gamma": 0.25}),
        rate_limit=RateLimit(
            S=rng.normal(size=(3, n)),
            T=rng.normal(size=(3, measured)),
            U=rng.normal(size=(3, 3)),
            V=rng.normal(size=(n, 3)),
            limits=np.array([0.4, 0.6, 0.8]),
        )
        if limited
        else None,
    )


@pytest.fixture
def handlers_and_collector_stay(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let a command in this process change signals and memory for its own time only."""
    monkeypatch.setattr(realtime, "freeze_gc", lambda **_: None)
    monkeypatch.setattr(realtime, "request_fifo_scheduling", lambda: False)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="session")
def fly_here():
    """Return what flies a plan in this process in place of two, to the same bits, or takes records as flown."""

    def fly(
        plan: FlightPlan,
        out: Path,
        records: Records | None = None,
        outcome: FlightOutcome = FlightOutcome.DONE,
        message: str = "it ended",
    ) -> Flight:
        scenario, controller, vehicle, seed, *_ = plan
        if records is None:
            records = fly_direct(scenario, controller, vehicle=vehicle, seed=seed)
        (journal := out / f"{plan.name}.journal").touch()
        return Flight(
            scenario=scenario, controller=controller, vehicle=vehicle, seed=seed, records=records, outcome=outcome,
            message=message, realtime_factor=9.0, journal=journal,
        )  # fmt: skip

    return fly


@pytest.fixture
def drawn(monkeypatch):
    """Catch figures when they are saved, so that what they show can be asked."""
    caught: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: caught.append(self))
    return caught


@pytest.fixture
def recorded(tmp_path):
    """Record flights that nobody flew: what stands in the journal is given by field."""
    return partial(_record, tmp_path)


@pytest.fixture(scope="module")
def recorded_once(tmp_path_factory):
    """Record such flights for all tests of a module."""
    return partial(_record, tmp_path_factory.mktemp("recorded"))


def _record(root, folder, *, scenario="coning", law="hinf-d1", seed=1, n=500, require=(), **fields):
    script = replace(load_scenario(scenario), duration_s=n / 250, require=require)
    plan = FlightPlan(script, load_law(law), load_vehicle("paper"), seed, False)
    records = np.zeros(n, dtype=record_type(np.shape(fields.get("rotors", [0.0] * 4))[-1]))
    records["time_us"] = 4000.0 * np.arange(n)
    records["q_NB"][:, 0] = 1.0
    records["omega_command_B"] = np.nan
    for name, values in fields.items():
        records[name] = values
    write_bag(root / folder / plan.name, records, {**plan.metadata(), "outcome": "done"})
    return root / folder


def _around(value: float, share: float = 0.05) -> Interval:
    return Interval(value * (1.0 - share), value, value * (1.0 + share))


@pytest.fixture
def log_of() -> Callable[[Records], FlightLog]:
    """Return what turns a flight into a log of torques in N m."""

    def convert(records: Records) -> FlightLog:
        time = records["time_us"] * 1e-6
        return FlightLog(
            source="flight.mcap",
            system="gustproof",
            gyro=LogSignal(time=time, values=records["gyro_B"]),
            command=LogSignal(time=time, values=records["torque_command_B"]),
            command_unit=CommandUnit.NEWTON_METRES,
            airborne=((float(time[0]), float(time[-1])),),
        )

    return convert


@pytest.fixture
def perfect() -> Callable[..., Identification]:
    """Return what makes a vehicle's identification without error."""

    def make(
        vehicle: Vehicle,
        *,
        unit: CommandUnit = CommandUnit.NEWTON_METRES,
        dt: float = 0.004,
        system: str = "gustproof",
    ) -> Identification:
        omega, time = np.geomspace(0.5, 100.0, 40), np.arange(0.0, 30.0, dt)
        lag = 1.0 / (1.0 + 1j * omega * vehicle.actuator_lag)
        model = np.array([lag / inertia for inertia in vehicle.inertia_B])
        acceleration = np.stack([np.sin(time + k) for k in range(3)], axis=1)
        axes = [
            AxisEstimate(
                gain=_around(1.0 / inertia),
                damping=_around(damping),
                noise=vehicle.gyro.noise_density,
                disturbance_rms=1.0,
                disturbance_corner=1.0,
                held_out_r2=0.9,
            )
            for inertia, damping in zip(vehicle.inertia_B, vehicle.rate_damping_B, strict=True)
        ]
        return Identification(
            source="flight.mcap",
            system=system,
            thrust_range=1.0,
            dt=dt,
            command_unit=unit,
            actuator_lag=_around(vehicle.actuator_lag),
            delay=Interval(0.0, 0.0, 0.001),
            lateness=Interval(vehicle.actuator_lag, vehicle.actuator_lag, vehicle.actuator_lag + 0.001),
            axes=(axes[0], axes[1], axes[2]),
            motor_gains=None,
            motor_intervals=None,
            omega=omega,
            response=model * 1.02,
            model=model,
            coherence=np.full((3, len(omega)), 0.9),
            time=time,
            acceleration=acceleration,
            predicted=0.95 * acceleration,
            findings=(),
        )

    return make


def _leaves(value, path=()):
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _leaves(item, (*path, key))
    else:
        yield path, value


def _changed(document, path, value=None):
    copy = deepcopy(document)
    place = copy
    for key in path[:-1]:
        place = place[key]
    old = place[path[-1]]
    if value is not None:
        place[path[-1]] = value
    elif isinstance(old, bool):
        place[path[-1]] = not old
    elif isinstance(old, float):
        place[path[-1]] = float(np.nextafter(old, np.inf))
    else:
        place[path[-1]] = old + 1 if isinstance(old, int) else old + "x"
    return copy
