"""Gains of PX4's and ArduPilot's own loops with the least attitude error in turbulence, at given Ms and slew.

Sequential quadratic programming (SLSQP) on the logarithms of gains and filters' corners. The limits are a sensitivity
peak of each axis, another at the corners of the vehicle's spreads, and a torque slew pooled over the axes. Filters of
the gyro are common to the axes. A parameter that the autopilot keeps as a whole number is rounded, and the others are
searched again beside it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import scipy

from firmware_model.config.firmware import check_measured, guessed_axes, is_measured
from firmware_model.config.parameter_files import GROUND_STATION_FORMS, write_parameters
from firmware_model.config.scenario import Scenario, with_measured_delay
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.vehicle import Vehicle
from firmware_model.external.interface import scenario_for
from firmware_model.types import Vector
from gustproof.airframe.covariance import (
    AxisModel,
    ClosedLoops,
    augmented_axis,
    axis_models,
    mean_second_moments,
    open_loop,
)
from gustproof.airframe.output_rounding import rounding_slew
from gustproof.airframe.predict import predict
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.design.loops.settings import AutopilotLoops, complete
from gustproof.errors import DesignError
from gustproof.law.cascade import AxisLaw
from gustproof.law.form import Law, Matrix
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, sensitivity

_GRID = 120
"""Number of frequencies, evenly spaced in the logarithm, at which sensitivity peaks are constrained."""
_GRID_MARGIN = 2e-3
"""[-] share of a peak reserved for a rise of the sensitivity between two frequencies of the grid."""
_CORNER_PEAKS = (1.5, 2.5, 4.0)
"""[-] sensitivity peaks at the corners of the spreads over the nominal one, tried in this order."""
_SPEEDS = (1.0, 0.4)
"""[-] of the starts, tried in this order until one leads to gains within the limits."""
_START = (4.0, 8.0, 16.0, 0.3)
"""[1/s, 1/s, 1/s^2, -] angle P, rate P, I and D of angular acceleration: stable at a lateness of `_LATENESS`."""
_LATENESS = 0.054
"""[s] actuator lag and delay for which `_START` is stated."""
_LEAST, _LEAST_ANGLE_P, _LEAST_I = 1e-3, 0.5, 0.25
"""[-] least gain as a share of the fastest start's; least angle P and I, so that both hold against a steady moment."""
_ANY = 1e-9, 1e9
"""Range of a parameter without one."""
_ROUNDS, _ITERATIONS, _TOLERANCE = 4, 150, 1e-3
"""Searches, each tightened by the excess of the last one; steps of each; relative excess that is rounding."""
_STEP = 1e-7
"""[-] by which a parameter's logarithm changes to find slopes."""
_LARGEST_CORNER = 0.45
"""[-] largest corner of a filter as a share of the rate."""
_K_STEPS = 10.0
"""[-] steps in 1 of an overall gain above 1; a tenth of these below."""
_UNSTABLE = 1e6
"""[rad] and [N*m/s] error and slew of a loop whose covariance overflows."""
_DIGITS, _SLEW_MARGIN = 5, 1e-4
"""Significant digits of a parameter in a file; share of the slew reserved for the digits left out."""


_LIKELY = 0.4
"""[-] of the way from the nominal peak to that over the spreads, by their logarithms: 150 of 155 flown stay below."""
_LIMITS_OF_USERS = ("_SMAX", "_IMAX")
"""Ends of the names of limits that are not gains: the user's own are left alone."""


class _Structure(NamedTuple):
    """Parameters that are tuned, and those that are not left to the autopilot's defaults."""

    axes: tuple[str, str, str]
    """Parts of the names of all parameters of roll, of pitch, and of yaw."""
    own: tuple[tuple[str, ...], ...]
    """Names for roll, pitch and yaw: angle P, rate P, I, D, then corners of filters."""
    shared: tuple[str, ...]
    """Names of corners common to the axes."""
    corners: tuple[float, float]
    """[Hz], [-] least corner of a filter, and largest as a share of the rate."""
    rate_max: tuple[str, str, str]
    """Names of the largest commanded rate [deg/s] about each axis."""
    fixed: Mapping[str, float]
    """Values of others."""
    notches: tuple[str, ...]
    """Names of what switches a notch on; the others of a notch begin alike."""
    most_corner: float = math.inf
    """[Hz] largest corner of a filter."""
    is_law: bool = False
    """True for the gains of a law, which no autopilot's document bounds."""

    def is_of_notch(self, name: str) -> bool:
        """Return whether a parameter is one of a notch."""
        return any(name.startswith(each[: each.rindex("_") + 1]) for each in self.notches)

    def with_notches(self, flown: Mapping[str, float]) -> "_Structure":
        """Return the structure with the notches of loops that are flown: the frame needs them, whatever the gains."""
        return self._replace(fixed={**self.fixed, **{name: flown[name] for name in flown if self.is_of_notch(name)}})

    def of_axes(self, axes: tuple[int, ...], values: Mapping[str, float]) -> dict[str, float]:
        """Return the values of the gains and filters of some axes."""
        parts, names = [self.axes[axis] for axis in axes], [*self.fixed, *(name for own in self.own for name in own)]
        return {name: values[name] for name in names if name in values and any(part in name for part in parts)}

    def as_law(self, vehicle: Vehicle) -> "_Structure":
        """Return the structure with the limit of rates that laws have, and filters as fast as samples allow."""
        limit = min(math.degrees(vehicle.stabilizer.rate_limit), 1000.0)
        corners = self.corners[0], _LARGEST_CORNER
        return self._replace(is_law=True, corners=corners, fixed={**self.fixed, **dict.fromkeys(self.rate_max, limit)})


_PX4 = _Structure(
    axes=("_ROLL", "_PITCH", "_YAW"),
    own=tuple(
        tuple(f"MC_{axis}{each}" for each in ("_P", "RATE_P", "RATE_I", "RATE_D")) for axis in ("ROLL", "PITCH", "YAW")
    ),
    shared=("IMU_GYRO_CUTOFF", "IMU_DGYRO_CUTOFF"),
    corners=(10.0, _LARGEST_CORNER),
    rate_max=("MC_ROLLRATE_MAX", "MC_PITCHRATE_MAX", "MC_YAWRATE_MAX"),
    fixed={"MC_YAW_TQ_CUTOFF": 0.0, **{f"MC_{axis}RATE_{each}": value for axis in ("ROLL", "PITCH", "YAW")
                                       for each, value in (("K", 1.0), ("FF", 0.0))}},
    notches=("IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF1_FRQ", "IMU_GYRO_DNF_FLOWN"),
)  # fmt: skip
_ARDUPILOT = _Structure(
    axes=("_RLL_", "_PIT_", "_YAW_"),
    own=tuple(
        (f"ATC_ANG_{axis}_P", *(f"ATC_RAT_{axis}_{each}" for each in ("P", "I", "D", "FLTD")))
        for axis in ("RLL", "PIT", "YAW")
    ),
    shared=("INS_GYRO_FILTER",),
    corners=(5.0, 0.25),
    rate_max=("ATC_RATE_R_MAX", "ATC_RATE_P_MAX", "ATC_RATE_Y_MAX"),
    fixed={f"ATC_RAT_{axis}_{each}": value for axis in ("RLL", "PIT", "YAW")
           for each, value in (("FLTT", 100.0), ("FLTE", 0.0), ("FF", 0.0), ("SMAX", 0.0), ("IMAX", 1.0))},
    notches=("INS_HNTCH_ENABLE", "INS_HNTC2_ENABLE"),
)  # fmt: skip
_STRUCTURES = {"px4": _PX4, "ardupilot": _ARDUPILOT}


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotTuning:
    """Gains of an autopilot's own loops, and what they are predicted to do."""

    kind: str
    """Autopilot, by the names of `--autopilot`."""
    parameters: dict[str, float]
    """Gains and filters but notches, by name."""
    law: Law
    """Law that these loops are."""
    rmse: float
    """[rad] rms attitude error, pooled over the axes."""
    seen_rmse: float
    """[rad] the same of the attitude that the autopilot sees, which the search minimises."""
    slew: float
    """[N*m/s] rms torque slew, pooled over the axes, with that of rounded outputs."""
    Ms: float
    """[-] largest sensitivity peak of the axes."""
    corner_Ms: float
    """[-] the same at the corners of the vehicle's spreads."""
    notches: Mapping[str, float] = field(default_factory=dict)
    """Changes of notches that belong to the gains [in their units]."""

    @property
    def likely_Ms(self) -> float:
        """[-] peak that 19 of 20 vehicles keep whose spreads are the 95 % intervals of a log, as the round trip flies.

        The nominal one is that of the best fit: half of the vehicles have more. All ends of the intervals at once are
        rarer than 1 in 20.
        """
        return float(self.Ms ** (1.0 - _LIKELY) * self.corner_Ms**_LIKELY)

    def describe_peaks(self, vehicle: Vehicle) -> str:
        """Return the sensitivity peaks, and how sure they are on a `vehicle` that a log measured."""
        likely = f" by the best fit, {self.likely_Ms:.2f} in 19 of 20" if is_measured(vehicle) else ""
        return f"Ms {self.Ms:.2f}{likely}, {self.corner_Ms:.2f} over the file's spreads"

    def describe_error(self) -> str:
        """Return the predicted error, the true one first."""
        own = f"{math.degrees(self.seen_rmse):.3g} deg by its own attitude, without the walk of the gyro's noise"
        return f"error {math.degrees(self.rmse):.3g} deg ({own})"

    def outside_ranges(self) -> list[str]:
        """Return a line for each parameter that leaves the range which the autopilot documents."""
        autopilot = AUTOPILOTS[self.kind]
        told = {name: autopilot.describe_limit(name, value) for name, value in self.parameters.items()}
        return [f"{name} {text}" for name, text in told.items() if text.startswith(("above", "below"))]

    def describe_notches(self) -> str:
        """Return what the gains take for granted about notches."""
        values = self.law.provenance.parameters
        found = [name for name in _STRUCTURES[self.kind].notches if values.get(name)]
        kept = "" if self.notches else " as judged"
        return f"designed with the notches of {', '.join(found)}{kept}" if found else "designed without notches"


def tune_gains(
    kind: str,
    vehicles: VehicleSet,
    scenario: Scenario,
    *,
    slew: float,
    sensitivity_peak: float = 1.4,
    in_simulation: bool = True,
    in_ranges: bool = True,
    most_corner: float = math.inf,
    flown: Mapping[str, float] = MappingProxyType({}),
    progress: Callable[[float, str], None] = lambda _share, _text: None,
) -> AutopilotTuning:
    """Return the gains of `px4` or `ardupilot` with the least attitude error in the scenario's turbulence.

    It is a local optimum from fixed starts: the same gains every time. The sensitivity peak [-] of each axis is at most
    `sensitivity_peak`, the rms torque slew pooled over the axes at most `slew` [N*m/s]. The loops run at the rate of
    the autopilot's simulation, which rounds its outputs. If not `in_simulation` they are a law for any vehicle: at the
    scenario's rate, without mixer, with parameters per torque limit. Notches, and the loops' rate, are those of the
    parameters that are `flown`; without these, there are none. Gains of an axis whose torque is a guess stay as flown,
    and its peaks do not count.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    ConfigError
        If the autopilot has no mixer for the vehicle, or its torque in yaw is a guess and no gains are flown.
    ValueError
        If the scenario has no turbulence.
    """
    autopilot, vehicle = AUTOPILOTS[kind], vehicles.nominal
    structure = _STRUCTURES[kind].with_notches(flown)
    structure = structure if in_simulation else structure.as_law(vehicle)
    structure = structure._replace(most_corner=most_corner)
    held = _find_held(vehicle, flown) if in_simulation else ()
    if in_simulation:
        scenario = scenario_for(kind, scenario, autopilot.find_rate(flown)[0])
    script = with_measured_delay(scenario, vehicle, on_board=in_simulation)
    step = autopilot.thrust_step(vehicle) if in_simulation else 0.0
    rounding = min(rounding_slew((slew, slew, slew), vehicle.rotors, step, script.dt), 0.9 * slew)
    fixed = complete(autopilot, structure.fixed)
    torque = autopilot.full_torque(vehicle, fixed) if in_simulation else vehicle.torque_limit
    most = (1.0 - _SLEW_MARGIN) * math.sqrt(slew**2 - rounding**2)
    whole = autopilot.whole if in_simulation else frozenset()
    search = _Search(autopilot, structure, vehicles, script, sensitivity_peak, most, torque, whole)
    values = search.run_all([_find_ranges(autopilot, structure), {}] if in_ranges else [{}], progress)
    if values is None:
        raise DesignError(
            f"no gains of {autopilot.name} found at sensitivity peak {sensitivity_peak:g}, "
            f"{_CORNER_PEAKS[-1] * sensitivity_peak:g} off nominal, and slew {slew:g} N*m/s"
        )
    values |= _split_gains(autopilot, structure, values)
    written = {name: float(f"{value:.{_DIGITS}g}") for name, value in values.items()}
    parameters = {**structure.fixed, **written, **structure.of_axes(held, complete(autopilot, flown))}
    law = autopilot_law(
        kind,
        parameters,
        vehicle,
        rate_hz=script.control_rate_hz,
        full_torque=torque,
        name=f"{kind}-{vehicle.name}",
    ).law
    predicted = predict(law, vehicle, script)
    assert predicted is not None  # as for a law of torque
    assert predicted.seen_rmse is not None  # on strapdown
    nominal, corner = search.peaks(values, held)
    return AutopilotTuning(
        kind=kind,
        parameters={name: value for name, value in parameters.items() if not structure.is_of_notch(name)},
        law=law,
        rmse=predicted.rmse,
        seen_rmse=predicted.seen_rmse,
        slew=math.hypot(predicted.slew, rounding_slew(predicted.axes_slew, vehicle.rotors, step, script.dt)),
        Ms=nominal,
        corner_Ms=corner,
    )


def _find_held(vehicle: Vehicle, flown: Mapping[str, float]) -> tuple[int, ...]:
    """Return the axes whose gains stay as `flown`; a yaw that is a guess is refused if none are."""
    if not flown:
        check_measured(vehicle)
        return ()
    return guessed_axes(vehicle)


def save_tuning(tuning: AutopilotTuning, vehicle: Vehicle, path: Path) -> None:
    """Write gains and filters of a tuning as a file that ground stations load over the user's parameters.

    Nothing else is written: frame, motors, hover thrust, limits, and notches that are not changed, stay the user's.
    """
    curve = "THR_MDL_FAC" if tuning.kind == "px4" else "MOT_THST_EXPO"
    source = "of the log" if is_measured(vehicle) else f"of the vehicle file; {curve} must make the thrust linear"
    head = [
        f"{AUTOPILOTS[tuning.kind].name}, vehicle '{vehicle.name}': gains of least attitude error in gusts",
        f"predicted: {tuning.describe_error()},",
        f"torque slew {tuning.slew:.3g} N m/s, {tuning.describe_peaks(vehicle)}",
        f"gains and filters alone, for frame and motors {source}",
        tuning.describe_notches(),
        *tuning.outside_ranges(),
    ]
    written = {**tuning.parameters, **tuning.notches}
    own = {name: f"{value:g}" for name, value in written.items() if not name.endswith(_LIMITS_OF_USERS)}
    write_parameters(own, path, GROUND_STATION_FORMS[tuning.kind], head)


class _AxisFigures(NamedTuple):
    """Figures of an axis, each followed by its slopes over the logarithms of n own and shared parameters."""

    error: Matrix
    """(1 + n,) [rad^2] mean square of the attitude."""
    slew: Matrix
    """(1 + n,) [(N*m/s)^2] mean square of the torque's slew."""
    difference: Matrix
    """(1 + n, plants, grid) logarithm of each plant's return difference."""


def _close_loops(P: Lti, A: Matrix, B: Matrix, C: Matrix, D: Matrix) -> ClosedLoops:
    """Return the loops of k controllers (k, ...) from gyro to command around a flight, as `lft` makes one."""
    by, to, gyro, noisy = P.B[:, -1:], P.D[:2, -1:], P.C[2:], P.D[2:, :-1]
    upper = np.concatenate([P.A + by @ D @ gyro, by @ C], axis=2)
    lower = np.concatenate([B @ gyro, A], axis=2)
    return ClosedLoops(
        A=np.concatenate([upper, lower], axis=1),
        B=np.concatenate([P.B[:, :-1] + by @ D @ noisy, B @ noisy], axis=1),
        C=np.concatenate([P.C[:2] + to @ D @ gyro, to @ C], axis=2),
        D=P.D[:2, :-1] + to @ D @ noisy,
        dt=P.dt,
    )


class _Search:
    """Search for one vehicle and scenario.

    The logarithms `z` are those of the own parameters of roll, pitch and yaw, then of the shared ones. `peak` is the
    largest sensitivity peak [-] of each axis of the nominal vehicle, `torque` [N*m] that of a command of 1. The `whole`
    parameters end at whole numbers.
    """

    def __init__(
        self,
        autopilot: AutopilotLoops,
        structure: _Structure,
        vehicles: VehicleSet,
        scenario: Scenario,
        peak: float,
        slew: float,
        torque: Vector,
        whole: frozenset[str],
    ) -> None:
        self._autopilot, self._structure, self._slew = autopilot, structure, slew
        self._fixed = complete(self._autopilot, self._structure.fixed)
        self._vehicle, self._rate, self._dt = vehicles.nominal, scenario.control_rate_hz, scenario.dt
        self._torque = torque
        self._axes = list(
            zip(*(axis_models(each, scenario) for each in (vehicles.nominal, *corner_vehicles(vehicles))), strict=True)
        )
        self._omega = np.geomspace(0.3, 0.999 * math.pi / scenario.dt, _GRID)
        self._plants = [np.array([self._response(model) for model in models]) for models in self._axes]
        self._peak = peak
        self._names = [*(name for own in structure.own for name in own), *structure.shared]
        self._whole = [place for place, name in enumerate(self._names) if name in whole]

    def run_all(
        self, choices: Sequence[Mapping[str, tuple[float, float]]], progress: Callable[[float, str], None]
    ) -> dict[str, float] | None:
        """Return the first parameters that are found: at the least peak off nominal, within the first ranges."""
        tries = list(product(_CORNER_PEAKS, choices, _SPEEDS))
        for number, (corner, ranges, speed) in enumerate(tries):
            progress(number / len(tries), f"try {number + 1}, Ms up to {corner * self._peak:.3g} over the spreads")
            values = self.run(corner, speed, ranges)
            if values is not None:
                return values
        return None

    def run(self, corner: float, speed: float, ranges: Mapping[str, tuple[float, float]]) -> dict[str, float] | None:
        """Return the parameters found from a start of a `speed` [-]; `None` if none are within the limits.

        The peak off nominal is at most `corner` [-] times the nominal one, and each parameter within its of `ranges`.
        """
        peaks = self._peak * np.array([1.0, *[corner] * (len(self._axes[0]) - 1)])
        start, low, high = self._start(speed)
        least, most = np.log([ranges.get(name, _ANY) for name in self._names]).T
        start, low, high = (np.clip(each, least, most) for each in (start, low, high))
        z = self._search(start, low, high, peaks)
        if z is not None and self._whole:  # the others make good for what rounding costs
            z[self._whole] = low[self._whole] = high[self._whole] = np.log(np.round(np.exp(z[self._whole])))
            z = self._search(z, low, high, peaks)
        return None if z is None else self._name(np.exp(z))

    def _search(self, z: Matrix, low: Matrix, high: Matrix, peaks: Matrix) -> Matrix | None:
        """Return the best `z` found from a start, within the largest peaks [-]; `None` if there is none."""
        room = _GRID_MARGIN
        for _ in range(_ROUNDS):
            found = self._minimize(z, low, high, np.log(peaks * (1.0 - room)))
            if found is None:
                return None
            z = found
            now = self.peaks(self._name(np.exp(z)))
            excess = max(peak / allowed for peak, allowed in zip(now, peaks[[0, -1]], strict=True))
            if excess <= 1.0:
                return z
            room += 1.1 * (excess - 1.0)
        return None

    def peaks(self, values: Mapping[str, float], without: tuple[int, ...] = ()) -> tuple[float, float]:
        """Return the largest sensitivity peaks [-] of the nominal axes and off nominal; infinite if not stable."""
        found = [
            [_peak(model, self._law(axis, values).controller(model.plant.dt)) for model in models]
            for axis, models in enumerate(self._axes)
            if axis not in without
        ]
        return max(each[0] for each in found), max(max(each[1:] or each) for each in found)

    def _minimize(self, z: Matrix, low: Matrix, high: Matrix, log_peaks: Matrix) -> Matrix | None:
        width, count = len(self._structure.own[0]), len(z)
        places = [np.r_[axis * width : (axis + 1) * width, 3 * width : count] for axis in range(3)]

        @cache  # a gain affects one axis, and the search evaluates error and margins at the same gains
        def evaluate(axis: int, values: tuple[float, ...]) -> _AxisFigures:
            return self._evaluate(axis, np.array(values))

        def evaluate_all(z: Matrix) -> list[_AxisFigures]:
            return [evaluate(axis, tuple(z[place].tolist())) for axis, place in enumerate(places)]

        def pool(figures: list[Matrix]) -> tuple[float, Matrix]:
            """Return the logarithm of an rms over the axes, and its slopes."""
            total, slopes = sum(float(each[0]) for each in figures), np.zeros(count)
            for place, each in zip(places, figures, strict=True):
                slopes[place] += 0.5 * each[1:] / total
            return 0.5 * math.log(total / 3.0), slopes

        def error(z: Matrix) -> tuple[float, Matrix]:
            return pool([each.error for each in evaluate_all(z)])

        def room(z: Matrix) -> Matrix:
            found = evaluate_all(z)
            margins = [(log_peaks[:, None] + each.difference[0]).ravel() for each in found]
            return np.append(np.concatenate(margins), math.log(self._slew) - pool([each.slew for each in found])[0])

        def room_slopes(z: Matrix) -> Matrix:
            found = evaluate_all(z)
            margins = np.zeros((3, self._plants[0].size, count))
            for rows, place, each in zip(margins, places, found, strict=True):
                rows[:, place] = each.difference[1:].reshape(len(place), -1).T
            return np.vstack([margins.reshape(-1, count), -pool([each.slew for each in found])[1]])

        found = scipy.optimize.minimize(
            error,
            z,
            jac=True,
            method="SLSQP",
            bounds=list(zip(low.tolist(), high.tolist(), strict=True)),
            constraints=scipy.optimize.NonlinearConstraint(room, 0.0, np.inf, jac=room_slopes),
            options={"maxiter": _ITERATIONS, "ftol": 1e-7},
        )
        return found.x if np.min(room(found.x)) > -_TOLERANCE else None

    def _evaluate(self, axis: int, z: Matrix) -> "_AxisFigures":
        """Return the figures of an axis at the logarithms of its own and the shared parameters."""
        model, names = self._axes[axis][0], (*self._structure.own[axis], *self._structure.shared)
        rows = np.exp(z + np.vstack([np.zeros(len(z)), _STEP * np.eye(len(z))])).tolist()
        laws = [self._law(axis, dict(zip(names, row, strict=True))) for row in rows]
        parts = zip(*((law.A_linear, law.B[:, :1], law.C, law.D[:, :1]) for law in laws), strict=True)
        A, B, C, D = (np.array(each) for each in parts)
        with np.errstate(all="ignore"):
            moments = mean_second_moments([model], _close_loops(augmented_axis(model), A, B, C, D))
        error, slew = moments[:, 0, 0], moments[:, 1, 1] / self._dt**2
        if not max(np.max(error), np.max(slew)) < _UNSTABLE**2:
            error, slew = np.full((2, len(rows)), _UNSTABLE**2)
        # the response's slopes follow from those of its matrices at one solution each of state and costate
        pencil = np.exp(1j * self._omega * self._dt)[:, None, None] * np.eye(A.shape[1]) - A[0]
        state = np.linalg.solve(pencil, B[0].astype(complex))[..., 0].T
        costate = np.linalg.solve(pencil.mT, C[0].T.astype(complex))[..., 0]
        response = (C[0] @ state + D[0])[0]
        dA, dB, dC, dD = ((each[1:] - each[0]) / _STEP for each in (A, B, C, D))
        slopes = np.sum(costate * (dA @ state + dB).mT, axis=2) + (dC @ state + dD)[:, 0]
        difference = 1.0 - response * self._plants[axis]
        change = -(slopes[:, None] * self._plants[axis] / difference).real
        return _AxisFigures(
            error=np.append(error[0], (error[1:] - error[0]) / _STEP),
            slew=np.append(slew[0], (slew[1:] - slew[0]) / _STEP),
            difference=np.concatenate([np.log(np.abs(difference))[None], change]),
        )

    def _law(self, axis: int, values: Mapping[str, float]) -> AxisLaw:
        built = self._autopilot.build(axis, {**self._fixed, **values}, self._torque[axis], self._rate)
        return built.axis_law(built.loop.order, None)

    def _response(self, model: AxisModel) -> Matrix:
        turn = np.exp(-1j * self._omega * model.plant.dt * model.delay_samples)
        return np.asarray(model.plant.response(self._omega)[:, 0, 0] * turn)

    def _start(self, speed: float) -> tuple[Matrix, Matrix, Matrix]:
        """Return start, least and largest `z`."""
        lateness = self._vehicle.actuator_lag + max(self._axes[0][0].delay_samples, 1) / self._rate
        usual = _LATENESS / lateness
        angle, p, i, d = _START[0] * usual, _START[1] * usual, _START[2] * usual**2, _START[3]
        least, share = self._structure.corners
        most = max(least, min(share * self._rate, self._structure.most_corner))
        filters = len(self._structure.own[0]) - 4
        rows = []
        for axis, (angle_p, *_) in enumerate(self._structure.own):
            largest = self._autopilot.documented[angle_p][1] or math.inf
            unit, slowest = self._vehicle.inertia_B[axis] / self._torque[axis], min(_LEAST_ANGLE_P * angle, largest)
            rows += [(min(max(speed * angle, slowest), largest), slowest, largest)]
            rows += [(speed * unit * p, _LEAST * unit * p, unit * p / _LEAST)]
            rows += [(max(speed**2, _LEAST_I) * unit * i, _LEAST_I * unit * i, unit * i / _LEAST)]
            rows += [(unit * d, _LEAST * unit * d, unit * d / _LEAST), *[(0.7 * most, least, most)] * filters]
        rows += [(0.7 * most, least, most)] * len(self._structure.shared)
        z, low, high = np.log(np.array(rows)).T
        return z, low, high

    def _name(self, values: Matrix) -> dict[str, float]:
        return dict(zip(self._names, values.tolist(), strict=True))


def _find_ranges(autopilot: AutopilotLoops, structure: _Structure) -> dict[str, tuple[float, float]]:
    """Return the least and the largest value of parameters by the autopilot's documents, an overall gain K in them."""
    found: dict[str, tuple[float, float]] = {}
    if structure.is_law:
        return found
    for name in [*(name for own in structure.own for name in own), *structure.shared]:
        low, high = autopilot.find_range(name)
        least, most = autopilot.find_range(_overall(name)) if _overall(name) in autopilot.settings else (1.0, 1.0)
        found[name] = least * low, most * high
    return found


def _overall(gain: str) -> str:
    return f"{gain[:-1]}K"


def _split_gains(autopilot: AutopilotLoops, structure: _Structure, values: Mapping[str, float]) -> dict[str, float]:
    """Return P, I and D of the same rate loops within their ranges, and the overall gains K that make them so."""
    found: dict[str, float] = {}
    for _, *gains in (names[:4] for names in structure.own):
        overall = _overall(gains[0])
        if overall in autopilot.settings and not structure.is_law:
            lows, highs = zip(*(autopilot.find_range(name) for name in gains), strict=True)
            excess = max(values[name] / high for name, high in zip(gains, highs, strict=True))
            share = min(values[name] / low for name, low in zip(gains, lows, strict=True))
            raised = min(math.ceil(_K_STEPS * excess) / _K_STEPS, autopilot.find_range(overall)[1])
            lowered = max(math.floor(_K_STEPS**2 * share), 1.0) / _K_STEPS**2
            K = raised if excess > 1.0 else min(lowered, 1.0)
            found |= {overall: K, **{name: values[name] / K for name in gains}}
    return found


def corner_vehicles(vehicles: VehicleSet) -> list[Vehicle]:
    """Return the vehicles with all inertias and the lag at the ends of their ranges; none without such a range."""
    inertias = [name for name in vehicles.spreads if name.startswith("inertia_B.")]
    heavier = [vehicles.vehicle_at(dict.fromkeys(inertias, end)) for end in (-1.0, 1.0)[: 2 * len(inertias)]]
    lags = vehicles.lag_range
    if not (heavier or lags):
        return []
    found = product(heavier or [vehicles.nominal], lags or [vehicles.nominal.actuator_lag])
    return [replace(vehicle, actuator_lag=lag) for vehicle, lag in found]


def _peak(model: AxisModel, controller: Lti) -> float:
    found = sensitivity(open_loop(model, controller))
    return hinf_norm(found).gain if found.is_stable() else math.inf
