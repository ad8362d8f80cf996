"""The whole road on random vehicles: a log of the true plant, identified, tuned, and the file flown on the true plant.

The plant here is exact and has nothing of the project's: gain, lag, delay of any fraction of a sample, damping. The
loops that fly it are those of the parameters, which other tests hold to PX4 and ArduPilot. GUSTPROOF_VEHICLES=200 flies
that many in place of the gate's, a quarter of an hour of one core: `GUSTPROOF_VEHICLES=200 pytest --timeout 0` and this
file.
"""

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy

from firmware_model.config.gyro_filters import gyro_filters
from firmware_model.config.parameter_files import read_parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import VehicleSet, load_vehicle_set
from firmware_model.errors import ConfigError
from firmware_model.types import AXES
from gustproof.airframe.predict import predict
from gustproof.design.autopilot_gains import AutopilotTuning, save_tuning, tune_gains
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.design.loops.settings import complete
from gustproof.design.tune import wanted_slew
from gustproof.errors import DesignError
from gustproof.logs.identify.filtered_command import run_filters
from gustproof.logs.identify.identification import Identification, Interval
from gustproof.logs.identify.identify_vehicle import identify
from gustproof.logs.identify.vehicle_file import Known, make_vehicle_file
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.robust.lti.state_space import Lti
from gustproof.studies.rate.judge import scenario_for, whole_slew
from gustproof.types import Array

pytestmark = pytest.mark.slow
SEEDS = range(int(os.environ["GUSTPROOF_VEHICLES"])) if "GUSTPROOF_VEHICLES" in os.environ else (0, 1, 3, 8, 19, 142)
RATE, DT = 400, 0.0025
"""[Hz], [s] of the loops."""
KINDS = ("px4 default", "px4 250 Hz", "ardupilot 400 Hz", "ardupilot default")
AIR = load_scenario("paper-turbulence")


class Plant(NamedTuple):
    """Angular acceleration of one axis: that of a command of 1, its lag and delay, and the damping."""

    gain: float
    """[rad/s^2]."""
    lag: float
    """[s]."""
    delay: float
    """[s]."""
    damping: float
    """[1/s]."""

    def sampled(self) -> tuple[Array, Array, Array, int]:
        """Return A (2, 2) of rate and torque, what the command before and the present one add, and whole samples."""
        whole = int(self.delay / DT)
        part = self.delay - whole * DT
        slope = np.array([[-self.damping, self.gain, 0.0], [0.0, -1.0 / self.lag, 1.0 / self.lag], [0.0, 0.0, 0.0]])
        all_of_it, first, rest = (scipy.linalg.expm(slope * time) for time in (DT, part, DT - part))
        return all_of_it[:2, :2], rest[:2, :2] @ first[:2, 2], rest[:2, 2], whole

    def response(self, omega: Array) -> Array:
        """Return the rate by the command (f,) at `omega` (f,) [rad/s]."""
        A, before, present, whole = self.sampled()
        z = np.exp(1j * omega * DT)
        pull = (before[None] / z[:, None] + present[None]) * z[:, None] ** -whole
        return np.asarray(np.linalg.solve(z[:, None, None] * np.eye(2) - A, pull[..., None])[:, 0, 0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A vehicle, the parameters that fly it, and how it is flown and logged."""

    seed: int
    kind: str
    axes: tuple[Plant, Plant, Plant]
    mass: float
    parameters: Mapping[str, float]
    doublets: bool

    @property
    def autopilot(self) -> str:
        return self.kind.split()[0]


def draw(seed: int) -> Case:
    """Return a random case: quick vehicles have much authority, and each is flown far from its best."""
    random, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    lag, delay = math.exp(random.uniform(math.log(0.008), math.log(0.2))), random.uniform(0.0, 0.02)
    usual = math.log(900.0) - math.log(450.0) * math.log(lag / 0.008) / math.log(25.0)
    gain = float(np.clip(math.exp(usual + 0.6 * random.standard_normal()), 2.0, 900.0))
    gains = gain, gain * random.uniform(0.7, 1.1), max(0.3, gain * random.uniform(0.06, 0.2))
    tilt, turn = random.uniform(0.1, 2.0), random.uniform(0.05, 0.6)
    axes = tuple(Plant(each, lag, delay, damping) for each, damping in zip(gains, (tilt, tilt, turn), strict=True))
    late, px4 = lag + delay + 0.008, kind.startswith("px4")
    parameters: dict[str, float] = {"IMU_GYRO_RATEMAX" if px4 else "SCHED_LOOP_RATE": RATE}
    speed, cut = random.uniform(0.2, 0.4) / late, random.uniform(30.0, 90.0)
    for axis, plant in enumerate(axes):
        own = speed * (1.0, 1.0, 0.5)[axis]
        P = own / plant.gain
        rate, angle = f"MC_{AXES[axis].upper()}RATE_", f"MC_{AXES[axis].upper()}_P"
        if not px4:
            short = ("RLL", "PIT", "YAW")[axis]
            rate, angle = f"ATC_RAT_{short}_", f"ATC_ANG_{short}_P"
            parameters |= {f"{rate}FLTT": 20.0, f"{rate}FLTE": 0.0, f"{rate}FLTD": 30.0}
        parameters |= {angle: 0.3 * own, f"{rate}P": P, f"{rate}I": 0.15 * P * own, f"{rate}D": 0.15 * P * late}
    notched, frequency, rotors = random.random() < 0.5, random.uniform(60.0, 120.0), int(random.choice([4, 6, 8]))
    if px4:
        parameters |= {"IMU_GYRO_CUTOFF": cut, "IMU_DGYRO_CUTOFF": 30.0, "MC_YAW_TQ_CUTOFF": 0.0}
        parameters |= {"CA_ROTOR_COUNT": rotors, **({"IMU_GYRO_NF0_FRQ": frequency} if notched else {})}
    else:
        parameters |= {"INS_GYRO_FILTER": cut, "FRAME_CLASS": {4: 1.0, 6: 2.0, 8: 3.0}[rotors]}
        parameters |= {"INS_HNTCH_ENABLE": float(notched), "INS_HNTCH_FREQ": frequency}
    mass, doublets = math.exp(random.uniform(math.log(0.03), math.log(25.0))), random.random() < 0.5
    return Case(seed=seed, kind=kind, axes=axes, mass=mass, parameters=parameters, doublets=doublets)


def controllers(autopilot: str, parameters: Mapping[str, float]) -> list[tuple[Lti, Array, Array]]:
    """Return the loop of each axis from gyro to command.

    Beside it stand how its reference enters (n + 1,), in states and command, and what clipping does to states (n,).
    """
    loops, found = AUTOPILOTS[autopilot], []
    values = complete(loops, parameters)
    for axis in range(3):
        built = loops.build(axis, values, 1.0, RATE)
        law = built.axis_law(built.loop.order, None)
        found.append((law.controller(DT), np.append(law.B[:, 1], law.D[0, 1]), law.H[:, 0]))
    return found


def fly(
    loops: list[tuple[Lti, Array, Array]], plants: list[Plant], reference: Array, gust: Array, noise: Array
) -> tuple[Array, Array]:
    """Return measured rates and commands (n, m) of m loops at once; commands are clipped at 1.

    All are (n, m): references [rad], accelerations of gusts [rad/s^2] and the gyro's noise [rad/s].
    """
    m, n = len(plants), 2 + max(K.A.shape[0] for K, _, _ in loops)
    # States, then noise, reference, gust, old and new command, and what is clipped, to the next states.
    step, read = np.zeros((m, n, n + 6)), np.zeros((m, n))
    through, late = np.zeros((m, 2)), np.zeros(m, int)
    for i, ((K, entry, windup), plant) in enumerate(zip(loops, plants, strict=True)):
        order = 2 + K.A.shape[0]
        A, before, present, late[i] = plant.sampled()
        step[i, :2, :2], step[i, 2:order, 2:order], step[i, 2:order, 0] = A, K.A, K.B[:, 0]
        step[i, 2:order, n], step[i, 2:order, n + 1], step[i, 0, n + 2] = K.B[:, 0], entry[:-1], DT
        step[i, :2, n + 3], step[i, :2, n + 4], step[i, 2:order, n + 5] = before, present, windup
        read[i, 0], read[i, 2:order], through[i] = K.D[0, 0], K.C[0], (K.D[0, 0], entry[-1])
    direct = noise * through[:, 0] + reference * through[:, 1]
    rates, most, at = np.zeros((len(noise), m)), late.max() + 1, np.arange(m)
    commands, state = np.zeros((len(noise) + most, m)), np.zeros((m, n + 6))
    for k in range(len(noise)):
        rates[k] = state[:, 0] + noise[k]
        wanted = np.einsum("ij,ij->i", read, state[:, :n]) + direct[k]
        commands[k + most] = np.clip(wanted, -1.0, 1.0)
        state[:, n], state[:, n + 1], state[:, n + 2] = noise[k], reference[k], gust[k]
        state[:, n + 3], state[:, n + 4] = commands[k + most - late - 1, at], commands[k + most - late, at]
        state[:, n + 5] = commands[k + most] - wanted
        state[:, :n] = (step @ state[..., None])[..., 0]
    return rates, commands[most:]


def signals(case: Case, duration: float) -> tuple[Array, Array, Array]:
    """Return references, gusts and noise (n, 3) of a flight: sticks that come and go, or one axis after another."""
    random, at = np.random.default_rng(1000 + case.seed), np.arange(0.0, duration, DT)
    speed = 0.3 / (case.axes[0].lag + case.axes[0].delay + 0.008)
    reference, gust = np.zeros((len(at), 3)), np.zeros((len(at), 3))
    for axis, plant in enumerate(case.axes):
        slow = scipy.signal.butter(2, min(6.0, speed) / (2.0 * math.pi), fs=RATE)
        sticks = scipy.signal.lfilter(*slow, random.standard_normal(len(at)))
        sticks *= (0.2, 0.2, 0.12)[axis] / sticks.std() * (np.sin(2.0 * math.pi * at / 20.0 + axis) > -0.3)
        turns = 0.25 * np.sign(np.sin(2.0 * math.pi * at / max(2.0, 12.0 / speed)))
        reference[:, axis] = turns * (np.floor(3.0 * at / duration) == axis) if case.doublets else sticks
        corner, size = random.uniform(1.0, 6.0), 0.06 * plant.gain * random.uniform(0.1, 0.5)
        white = math.sqrt(2.0 * corner * DT) * size * random.standard_normal(len(at))
        gust[:, axis] = scipy.signal.lfilter([1.0], [1.0, corner * DT - 1.0], white)
    return reference, gust, 0.0015 * math.sqrt(0.5 / DT) * random.standard_normal((len(at), 3))


def write_log(case: Case, reference: Array, gyro: Array, command: Array) -> FlightLog:
    """Return what the autopilot logs of a flight: some samples, means of raw ones, or those behind its filters."""
    at = DT * np.arange(len(gyro))
    filters = gyro_filters(case.autopilot, case.parameters, float(RATE))
    smooth = np.column_stack([run_filters(column, filters) for column in gyro.T])
    is_raw = case.kind == "px4 default"
    if is_raw:
        measured = LogSignal(time=at.reshape(-1, 2).mean(axis=1), values=gyro.reshape(-1, 2, 3).mean(axis=1))
        logged = np.arange(0, len(at), 8)
    else:
        each = {"px4 250 Hz": 250 / 400, "ardupilot 400 Hz": 1.0, "ardupilot default": 25 / 400}[case.kind]
        kept = np.flatnonzero(np.diff(np.floor(np.arange(len(at)) * each), prepend=-1.0))
        measured = LogSignal(time=at[kept], values=smooth[kept])
        logged = np.arange(0, len(at), 40) if case.kind == "ardupilot default" else kept
    return FlightLog(
        source=f"{case.seed}.ulg" if case.autopilot == "px4" else f"{case.seed}.bin",
        system=case.autopilot,
        gyro=measured,
        is_gyro_raw=is_raw,
        command=LogSignal(time=at[logged], values=command[logged]),
        reference=LogSignal(time=at[::8], values=reference[::8]),
        airborne=((0.0, float(at[-1])),),
        parameters=case.parameters,
    )


def fly_all(cases: list[Case], duration: float = 90.0) -> list[FlightLog]:
    """Return the log of each case, all flown beside each other."""
    inputs = [signals(case, duration) for case in cases]
    loops = [loop for case in cases for loop in controllers(case.autopilot, case.parameters)]
    gyro, command = fly(
        loops, [plant for case in cases for plant in case.axes], *map(np.hstack, zip(*inputs, strict=True))
    )
    return [
        write_log(case, own[0], gyro[:, 3 * i : 3 * i + 3], command[:, 3 * i : 3 * i + 3])
        for i, (case, own) in enumerate(zip(cases, inputs, strict=True))
    ]


@dataclass(slots=True, kw_only=True)
class Trip:
    """What came of a case: a refusal, or promises and what the true plant says of them."""

    case: Case
    refusal: str = ""
    inside: dict[str, list[bool]]
    """Whether intervals hold the truth, by what they are of."""
    promised: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Ms, Ms over the spreads, and slew."""
    likely: float = 0.0
    """Ms promised for 19 of 20."""
    Ms: float = 0.0
    """True one."""
    slew: float = 0.0
    """By the true vehicle."""
    rests: bool = True
    """Whether the true vehicle comes to rest after a step of 10 deg."""


def travel(case: Case, log: FlightLog, folder: Path) -> Trip:
    """Identify, tune, and load the written file over the flown parameters; judge it on the true plant."""
    trip = Trip(case=case, inside={})
    try:
        found = identify(log)
        trip.inside = compare(case, found)
        path = folder / f"{case.seed}.toml"
        path.write_text(make_vehicle_file(f"v{case.seed}", found, Known(mass=case.mass)).text)
        vehicles = load_vehicle_set(path)
        limit = wanted_slew(vehicles.nominal, AIR, None, 1.4)
        tuning = tune_gains(case.autopilot, vehicles, AIR, slew=limit, flown=case.parameters)
    except (ConfigError, DesignError) as error:
        trip.refusal = str(error)
        return trip
    judge(trip, tuning, vehicles, folder)
    return trip


def judge(trip: Trip, tuning: AutopilotTuning, vehicles: VehicleSet, folder: Path) -> None:
    """Add to a trip what was promised, and what the file does to the true plant."""
    case, vehicle = trip.case, vehicles.nominal
    file = folder / f"{case.seed}.params"
    save_tuning(tuning, vehicle, file)
    written = {name: float(value) for name, value in read_parameters(str(file), "", []).items()}
    assert not any(name.startswith(("CA_", "FRAME_", "MOT_", "MPC_")) for name in written)
    parameters, rows = {**case.parameters, **written}, zip(vehicle.inertia_B, case.axes, strict=True)
    true = replace(
        vehicle,
        torque_limit=tuple(inertia * plant.gain for inertia, plant in rows),
        actuator_lag=case.axes[0].lag,
        rate_damping=tuple(plant.damping for plant in case.axes),
        command=replace(vehicle.command, delay=case.axes[0].delay),
    )
    law = autopilot_law(case.autopilot, parameters, true).law
    script = scenario_for(law, true, AIR)
    predicted, step = predict(law, true, script), AUTOPILOTS[case.autopilot].thrust_step(true)
    trip.likely = tuning.likely_Ms
    trip.promised = tuning.Ms, tuning.corner_Ms, tuning.slew
    trip.slew = math.inf if predicted is None else whole_slew(predicted, true, step, script)
    loops, omega = controllers(case.autopilot, parameters), np.geomspace(0.1, 0.999 * math.pi / DT, 2500)
    returned = [
        K.response(omega)[:, 0, 0] * plant.response(omega) for (K, *_), plant in zip(loops, case.axes, strict=True)
    ]
    trip.Ms = max(float(np.max(1.0 / np.abs(1.0 - each))) for each in returned)
    still = np.zeros((24_000, 3))  # a minute: an axis that its log did not show keeps its gains, however slow
    rates, _ = fly(loops, list(case.axes), np.full_like(still, math.radians(10.0)), still, still)
    trip.rests = bool(np.all(np.abs(rates[-800:]).max(axis=0) < 0.02 * np.abs(rates).max(axis=0)))


def compare(case: Case, found: Identification) -> dict[str, list[bool]]:
    """Return whether each interval holds the truth."""
    lag, delay = case.axes[0].lag, case.axes[0].delay
    pairs: list[tuple[str, Interval | None, float]] = [
        ("lag", found.actuator_lag, lag), ("delay", found.delay, delay), ("sum", found.lateness, lag + delay),
    ]  # fmt: skip
    for axis, plant in zip(found.axes, case.axes, strict=True):
        pairs += [("gain", axis.gain, plant.gain), ("damping", axis.damping, plant.damping)]
    inside: dict[str, list[bool]] = {}
    for name, interval, truth in pairs:
        if interval is not None:
            inside.setdefault(name, []).append(bool(interval.low <= truth <= interval.high))
    return inside


@pytest.fixture(scope="module")
def trips(tmp_path_factory: pytest.TempPathFactory) -> list[Trip]:
    cases = [draw(seed) for seed in SEEDS]
    folder = tmp_path_factory.mktemp("trips")
    return [travel(case, log, folder) for case, log in zip(cases, fly_all(cases), strict=True)]


def check_few(wrong: list[Any], count: int, share: float = 0.05) -> None:
    """Fail if more than one, and more than a share of all, are wrong."""
    assert len(wrong) <= max(1, share * count), f"{len(wrong)} of {count} fall short: {wrong}"


@pytest.fixture(scope="module")
def flown(trips: list[Trip]) -> list[Trip]:
    return [trip for trip in trips if not trip.refusal]


def test_files_keep_their_promises_on_the_true_vehicle(trips: list[Trip], flown: list[Trip]) -> None:
    """Lag and delay are known to a tenth or two: a tenth of the vehicles has more than 1.1 times the nominal Ms."""
    assert len(flown) >= 0.3 * len(trips)
    assert all(trip.rests for trip in flown)
    for limit, share in ((0, 0.12), (1, 0.05)):
        found = [(trip.case.seed, trip.promised, trip.Ms) for trip in flown if trip.Ms > 1.1 * trip.promised[limit]]
        check_few(found, len(flown), share)
    check_few([(trip.case.seed, trip.likely, trip.Ms) for trip in flown if trip.Ms > trip.likely], len(flown))
    slews = [(trip.case.seed, ratio) for trip in flown if not 0.8 < (ratio := trip.slew / trip.promised[2]) < 1.2]
    check_few(slews, len(flown))


@pytest.mark.parametrize("of", ["gain", "sum", "damping"])
def test_intervals_hold_the_truth(flown: list[Trip], of: str) -> None:
    found = [(trip.case.seed, holds) for trip in flown for holds in trip.inside[of]]
    check_few([seed for seed, holds in found if not holds], len(found))


def test_refusals_name_their_first_cause(trips: list[Trip]) -> None:
    """A log of 10 Hz is too slow, whatever the flight; others have what it takes, so it is the flight or the limits."""
    for trip in trips:
        is_slow = trip.case.kind == "ardupilot default"
        cause = "the log is too slow" if is_slow else r"is not (identified|excited)|excite yaw"
        assert re.search(f"{cause}|no gains" if trip.refusal else "^$", trip.refusal), trip.refusal
