"""Deterministic tests of a simulator's physics, each against what it states of itself or what a standard says.

Every flight begins in a chosen state and lasts a fraction of a second, before drag and attitude change the motion. An
acceleration is extrapolated to the first instant from two spans.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial.transform import Rotation

from firmware_model.config.vehicle import GRAVITY
from firmware_model.numerics.rotations import euler_angles
from firmware_model.types import AXES, Vector
from gustproof.studies.audit.simulator import (
    STILL,
    Airframe,
    Array,
    FlightStart,
    NotReachable,
    RequestedAir,
    Simulator,
    TrueMotion,
)
from gustproof.studies.audit.turbulence import TURBULENT, chance_deviation, estimate_turbulence, expected_turbulence

_DT = 0.004  # [s] step of the flights
_COARSE_DT, _FINE_DT = 0.02, 0.004  # [s] steps of the two turbulence records
_FLIGHT_STEPS, _FLIGHT_TIME = (0.005, 0.00125), 120.0  # [s] of level flights, where no record of the wind is had
_SAMPLES = 50_000  # of a turbulence record
_SPAN = 2  # [steps] the shorter of the two spans of an extrapolation
_STEP = 0.05  # [-] change of a rotor command, small beside hover
_SPIN_B = (2.0, 1.5, 1.0)  # [rad/s] B, of the gyroscopic test
_TURN, _TURN_TIME = 6.0, 0.3  # [rad/s^2] and [s] of the test of axes: the angle stays small
_BLOW, _BLOWN = 5.0, 0.3  # [m/s] wind, and [s] in it: long enough to be carried, too short to turn over
_SEED = 1


class AuditVerdict(Enum):
    """Result of a test."""

    PASSED = "passed"
    FAILED = "FAILED"
    NOT_REACHABLE = "not reachable"


@dataclass(frozen=True)
class Row:
    """A test of the audit."""

    test: str
    """Short name."""
    measured: str
    """Quantity, with its unit."""
    expected: str
    """Value that it should have; for what is not reachable the reason."""
    found: tuple[float, ...]
    """[unit of the quantity] Values that were measured."""
    tolerance: str
    """Allowed difference."""
    source: str
    """Law, standard or statement that the expected value is from."""
    verdict: AuditVerdict
    """Result."""


def audit(simulator: Simulator) -> list[Row]:
    """Return the rows of all tests of a simulator."""
    rows: list[Row] = []
    for test, source, check in _TESTS:
        results = (
            Row(test, each.measured, each.expected, each.found, each.tolerance, source, each.verdict)
            for each in check(simulator)
        )
        try:
            rows.extend(results)
        except NotReachable as reason:
            rows.append(Row(test, "", str(reason), (), "", source, AuditVerdict.NOT_REACHABLE))
    return rows


class _Result:
    """Values found beside those expected, with a tolerance each; without expected ones, each must be positive."""

    def __init__(
        self, measured: str, found: Array, expected: Array | None = None, tolerance: Array | float = 0.0
    ) -> None:
        self.measured, self.found = measured, tuple(np.ravel(found).tolist())
        if expected is None:
            self.expected, self.tolerance, passed = "> 0", "", np.greater(found, 0.0)
        else:
            # A NaN is no value that is within any tolerance.
            passed = np.abs(found - expected) <= tolerance
            self.expected = format_values(np.ravel(expected))
            self.tolerance = format_values(np.ravel(tolerance))
        self.verdict = AuditVerdict.PASSED if np.all(passed) else AuditVerdict.FAILED


def format_values(values: Array | tuple[float, ...]) -> str:
    """Return numbers as text of four digits."""
    return ", ".join(f"{value:.4g}" for value in values)


def _accelerations(simulator: Simulator, rotors: Array, omega_B: Vector = (0.0, 0.0, 0.0)) -> tuple[Array, Array]:
    """Return acceleration (3,) [m/s^2] N and angular acceleration (3,) [rad/s^2] B at the start of a flight."""
    motions = simulator.fly(_SEED, _DT, STILL, FlightStart(rotors, omega_B), rotors, 2 * _SPAN * _DT)
    begin, middle, end = (np.concatenate([m.velocity_N, m.omega_B]) for m in motions[::_SPAN])
    # The slopes over h and 2 h, extrapolated to a span of none.
    slope = (4.0 * (middle - begin) - (end - begin)) / (2.0 * _SPAN * _DT)
    return slope[:3], slope[3:]


def _fly(
    simulator: Simulator, start: FlightStart, rotors: Array, duration: float, air: RequestedAir = STILL
) -> list[TrueMotion]:
    """Return all motions of a flight of `duration` [s] under constant commands."""
    return simulator.fly(_SEED, _DT, air, start, rotors, duration)


def _gravity(simulator: Simulator) -> Iterator[_Result]:
    fall, _ = _accelerations(simulator, np.zeros(len(simulator.airframe.spin)))
    yield _Result("fall with stopped rotors, N [m/s^2]", fall, np.array((0.0, 0.0, GRAVITY)), 0.01)


def _thrust_curve(simulator: Simulator) -> Iterator[_Result]:
    airframe = simulator.airframe
    count = len(airframe.spin)
    levels = np.array((0.25, 0.5, 0.75, 1.0))
    fall, _ = _accelerations(simulator, np.zeros(count))
    lift = [fall[2] - _accelerations(simulator, np.full(count, level))[0][2] for level in levels]
    expected = count * airframe.thrusts(levels)
    measured = "thrust of all rotors at commands .25, .5, .75, 1 [N]"
    yield _Result(measured, airframe.mass * np.array(lift), expected, 0.02 * expected)


def _geometry(simulator: Simulator) -> Iterator[_Result]:
    airframe = simulator.airframe
    hover, inertia = airframe.hover(), np.array(airframe.inertia_B)
    fall, turn = _accelerations(simulator, hover)
    changes = []
    for rotor in np.eye(len(hover)) * _STEP:
        a, alpha = _accelerations(simulator, hover + rotor)
        changes.append((*inertia * (alpha - turn), airframe.mass * (fall[2] - a[2])))
    roll, pitch, yaw, thrust = np.array(changes).T
    stated = airframe.thrusts(hover + _STEP) - airframe.thrusts(hover)
    yield _Result("thrust of each rotor by what it states [-]", thrust / stated, np.ones_like(stated), 0.03)
    x, y, _ = np.array(airframe.position_B).T
    arm = 0.03 * float(np.hypot(x, y).max())
    yield _Result("pitch torque of each rotor per thrust: x [m]", pitch / thrust, x, arm)
    yield _Result("roll torque of each rotor per thrust: y [m]", -roll / thrust, y, arm)
    drag = airframe.drag_ratio * np.array(airframe.spin)
    yield _Result("yaw torque of each rotor per thrust [m]", yaw / thrust, drag, 0.03 * airframe.drag_ratio)


def _lag(simulator: Simulator) -> Iterator[_Result]:
    airframe = simulator.airframe
    hover = airframe.hover()
    half = max(0.15, 6.0 * airframe.actuator_lag)
    more = hover + _STEP
    lift = _accelerations(simulator, hover)[0][2] - _accelerations(simulator, more)[0][2]
    late, prompt = (_fly(simulator, FlightStart(rotors), more, 2.0 * half) for rotors in (hover, more))
    middle, end = (late[i].velocity_N[2] - prompt[i].velocity_N[2] for i in (len(late) // 2, -1))
    # Rotors that lag lose lift times lag of climb; heave drag then eats it up, by the same factor in each half.
    found = np.array([middle**2 / end / lift])
    yield _Result("time constant of collective thrust [s]", found, np.array([airframe.actuator_lag]), 0.1 * found)


def _axes(simulator: Simulator) -> Iterator[_Result]:
    airframe = simulator.airframe
    hover = airframe.hover()
    sideways = ((1, 1.0, "velocity to the right"), (0, -1.0, "velocity backward"), None)
    for axis, (name, drift) in enumerate(zip(AXES, sideways, strict=True)):
        rotors = hover + _turning(airframe, hover, axis)
        end = _fly(simulator, FlightStart(hover), rotors, _TURN_TIME)[-1]
        found = [end.omega_B[axis], _euler(end)[axis]]
        measured = f"rate [rad/s] and angle [rad] under a {name} command"
        if drift is not None:
            found.append(drift[1] * end.velocity_N[drift[0]])
            measured += f", {drift[2]} [m/s]"
        yield _Result(measured, np.array(found))


def _turning(airframe: Airframe, hover: Array, axis: int) -> Array:
    """Return the changes (n,) of hovering rotors' commands that turn the vehicle about an axis, by its geometry."""
    thrusts = np.linalg.pinv(airframe.wrench)[:, axis] * airframe.inertia_B[axis] * _TURN
    changes = thrusts * _STEP / (airframe.thrusts(hover + _STEP) - airframe.thrusts(hover))
    return np.asarray(changes * min(1.0, 2.0 * _STEP / float(np.abs(changes).max())))


def _kinematics(simulator: Simulator) -> Iterator[_Result]:
    hover = simulator.airframe.hover()
    motions = _fly(simulator, FlightStart(hover, (0.5, -0.3, 0.4)), hover, 0.5)
    rates = np.array([motion.omega_B for motion in motions])
    attitude = _rotation(motions[0])
    for rate in 0.5 * (rates[1:] + rates[:-1]):
        attitude = attitude * Rotation.from_rotvec(_DT * rate)
    apart = float((attitude.inv() * _rotation(motions[-1])).magnitude())
    measured = "attitude after .5 s less the integral of the rates [deg]"
    yield _Result(measured, np.degrees([apart]), np.zeros(1), 0.1)


def _gyroscopic(simulator: Simulator) -> Iterator[_Result]:
    airframe = simulator.airframe
    hover, inertia, omega = airframe.hover(), np.array(airframe.inertia_B), np.array(_SPIN_B)
    expected = -np.cross(omega, inertia * omega) / inertia
    if np.linalg.norm(expected) < 0.05:
        raise NotReachable("the stated inertia is the same about all axes: there is no such moment")
    opposite = (-_SPIN_B[0], -_SPIN_B[1], -_SPIN_B[2])
    still, one, other = (_accelerations(simulator, hover, spin)[1] for spin in ((0.0, 0.0, 0.0), _SPIN_B, opposite))
    # Damping and the rotors' own momentum change sign with the rates, the wanted term does not.
    tolerance = 0.05 * float(np.linalg.norm(expected))
    yield _Result("angular acceleration, even in the rates [rad/s^2]", 0.5 * (one + other) - still, expected, tolerance)


def _wind(simulator: Simulator) -> Iterator[_Result]:
    calm = simulator.hover(_SEED, _DT, STILL, _BLOWN)[-1].velocity_N
    for axis, name in enumerate(("north", "east", "down")):
        wind = np.eye(3)[axis] * _BLOW
        blown = simulator.hover(_SEED, _DT, RequestedAir((wind[0], wind[1], wind[2])), _BLOWN)[-1].velocity_N
        gained = np.array([blown[axis] - calm[axis]])
        yield _Result(f"velocity gained {name} in {_BLOW:g} m/s of wind toward {name} [m/s]", gained)


def _spectrum(simulator: Simulator) -> Iterator[_Result]:
    record = simulator.sample_air(_SEED, _COARSE_DT, TURBULENT, _SAMPLES)
    found, model = estimate_turbulence(record, _COARSE_DT), expected_turbulence()
    quantities = ("mean wind, N [m/s]", "intensity of u, v, w [m/s]", "break frequency of u, v, w [rad/s]")
    chance = chance_deviation(model, _COARSE_DT * _SAMPLES)
    for measured, value, expected, tolerance in zip(quantities, found, model, chance, strict=True):
        yield _Result(measured, value, expected, tolerance)


def _step_size(simulator: Simulator) -> Iterator[_Result]:
    try:
        yield _intensity_ratio(simulator)
    except NotReachable:
        yield _shaking_ratio(simulator)


def _shaking_ratio(simulator: Simulator) -> _Result:
    """Return by how much more or less turbulence changes the velocity of a level vehicle at the finer step."""
    air, spreads = RequestedAir(turbulence=TURBULENT.turbulence), []
    for dt in _FLIGHT_STEPS:
        period, motions = simulator.level_flight(_SEED, dt, air, _FLIGHT_TIME)
        seconds = np.array([motion.velocity_N[:2] for motion in motions])[:: round(1.0 / period)]
        spreads.append(float(np.diff(seconds, axis=0).std()))
    # Four standard deviations of the ratio of two spreads, from one number for each second and horizontal axis.
    tolerance = 4.0 / np.sqrt(2.0 * _FLIGHT_TIME)
    coarse, fine = _FLIGHT_STEPS
    measured = f"change of horizontal velocity in 1 s of level flight, steps of {fine:g} s by {coarse:g} s [-]"
    return _Result(measured, np.array([spreads[1] / spreads[0]]), np.ones(1), tolerance)


def _intensity_ratio(simulator: Simulator) -> _Result:
    coarse, fine = (simulator.sample_air(_SEED, dt, TURBULENT, _SAMPLES).std(axis=0) for dt in (_COARSE_DT, _FINE_DT))
    model = expected_turbulence()
    shares = [chance_deviation(model, dt * _SAMPLES)[1] / model.intensity for dt in (_COARSE_DT, _FINE_DT)]
    measured = f"intensity of u, v, w at steps of {_FINE_DT:g} s by that at {_COARSE_DT:g} s [-]"
    return _Result(measured, fine / coarse, np.ones(3), np.hypot(*shares))


def _seeds(simulator: Simulator) -> Iterator[_Result]:
    one, again, other = (simulator.sample_air(seed, _DT, TURBULENT, 500) for seed in (_SEED, _SEED, _SEED + 1))
    yield _Result("samples of wind that differ with the same seed", np.sum(one != again, axis=0), np.zeros(3))
    yield _Result("samples of wind that differ with another seed", np.sum(one != other, axis=0))
    hover = simulator.airframe.hover()
    flights = [_fly(simulator, FlightStart(hover), hover, 0.2, TURBULENT)[-1] for _ in range(2)]
    first, second = (np.concatenate(list(motion)) for motion in flights)
    differing = np.array([np.sum(first != second)])
    yield _Result("numbers of a flight in gusts that differ with the same seed", differing, np.zeros(1))


def _euler(motion: TrueMotion) -> Array:
    return np.asarray(euler_angles(np.array([motion.q_NB]))[0])


def _rotation(motion: TrueMotion) -> Rotation:
    return Rotation.from_quat(np.roll(motion.q_NB, -1))


_STATED = "the simulator's own statement of its vehicle"
_DRYDEN = "MIL-F-8785C, 3.7.2 and 3.7.3.4"
_TESTS: tuple[tuple[str, str, Callable[[Simulator], Iterator[_Result]]], ...] = (
    ("gravity", "3rd CGPM, 1901: 9.80665 m/s^2", _gravity),
    ("thrust curve", _STATED, _thrust_curve),
    ("rotor geometry", _STATED, _geometry),
    ("actuator lag", _STATED, _lag),
    ("sign of axes", "ISO 1151-1: forward, right, down", _axes),
    ("kinematics", "Diebel 2006: q' = q omega / 2", _kinematics),
    ("gyroscopic term", "Euler's equations: -omega x I omega", _gyroscopic),
    ("sign of wind", "drag is along the relative wind", _wind),
    ("turbulence", _DRYDEN, _spectrum),
    ("step of turbulence", _DRYDEN, _step_size),
    ("seeds", "repeatable experiments", _seeds),
)
