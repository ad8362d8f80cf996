"""Operating point of any controller: margins and torque slew, from flights alone.

A moment of many sines turns the vehicle about one axis at a time, in calm air. Records of these flights hold rates,
actuator torques and commands. They give the vehicle's response `P` from command to rate by least squares, and the
pilot's response `K` from rate to command at each sine. The loop transfer at the plant's input is `-K P`.

Nothing of the controller is known but its commands, so laws, Python objects and C libraries are judged alike. The
stated margins are those of small motions about hover; `MeasuredPoint.distortion` tells how far from linear it is there.

References
----------
R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd edition 2012, chapters 2 and 5:
periodic excitation, random-phase multisines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import MomentSine
from firmware_model.types import AXES
from gustproof.errors import DesignError
from gustproof.flight.controllers.user_controller import Controller
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.metrics import measure
from gustproof.robust.lti.margins import LoopMargins, response_margins
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix
from gustproof.types import Records, finite_or_none

PERIOD_S, _SETTLING_S = 16.0, 16.0
"""[s] period of the sines together, and flight before it."""
_LINES = 110
"""Number of sines, about evenly spaced in the logarithm of frequency."""
_HIGHEST = 0.97
"""[-] highest frequency as a share of half the sample rate."""
RATE = 2e-3
"""[rad/s] rate that each sine would give the free body: together some 0.8 deg/s rms, as in turbulence."""
_QUIETER = 0.5
"""[-] times the amplitude of the second flights, for the distortion."""
_SEEDS = (1, 2, 3)
"""Seeds of the flights in turbulence."""
_FINE = 4000
"""Number of frequencies between which the interpolated response is searched."""
_UNSTEADY = 0.05
"""[-] largest relative change of the rates from one period to the next: beyond it the loop has not settled."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPoint:
    """Robustness of a controller on a vehicle, and the torque slew that it takes in turbulence."""

    controller: str
    """Name of the controller."""
    vehicle: str
    """Name of the vehicle."""
    scenario: str
    """Name of the scenario that gives sample time, delay and turbulence."""
    axes: tuple[LoopMargins, ...]
    """Margins of roll, pitch and yaw, each with the other axes closed."""
    slew: float | None
    """[N*m/s] rms torque slew in the scenario, all axes and flights together; `None` if it was not flown."""
    distortion: float
    """[-] distance of the controller from a linear one: the larger of two shares of the worst axis.

    One is the relative change of the sensitivity at half the amplitude, rms over the sines. The other is the share of
    the commands' rms at frequencies that no sine has."""

    @property
    def Ms(self) -> float:
        """[-] largest sensitivity of the worst axis."""
        return max(axis.Ms for axis in self.axes)

    @property
    def gain_margin(self) -> float:
        """[-] least destabilising factor above 1; infinite if there is none."""
        return min(axis.gain_margin for axis in self.axes)

    @property
    def delay_margin(self) -> float:
        """[s] least destabilising additional delay; infinite if there is none."""
        return min(axis.delay_margin for axis in self.axes)

    def to_dict(self) -> dict[str, Any]:
        """Return the operating point as JSON values; `None` is infinite."""
        return {
            "pilot": self.controller,
            "vehicle": self.vehicle,
            "scenario": self.scenario,
            "Ms": self.Ms,
            "gain_margin": finite_or_none(self.gain_margin),
            "delay_margin_s": finite_or_none(self.delay_margin),
            "slew": self.slew,
            "distortion": self.distortion,
            "axes": {
                name: {
                    "Ms": axis.Ms,
                    "gain_margin": finite_or_none(axis.gain_margin),
                    "gain_reduction_margin": axis.gain_reduction_margin,
                    "delay_margin_s": finite_or_none(axis.delay_margin),
                    "phase_margin_deg": math.degrees(axis.phase_margin),
                    "crossover_rad_s": axis.crossover,
                }
                for name, axis in zip(AXES, self.axes, strict=True)
            },
        }


def measure_operating_point(
    controller: Controller,
    vehicle: Vehicle,
    scenario: Scenario,
    *,
    amplitude: float = RATE,
    seeds: Sequence[int] = _SEEDS,
) -> MeasuredPoint:
    """Return the operating point of a controller from its flights: six in calm air, and those in the scenario itself.

    The experiment holds the vehicle on the test stand, without noise and sensor bias, at the rates and the delay of
    `scenario`. The slew is that of the scenario as it is, flown with `seeds`; without any there is none.

    Parameters
    ----------
    controller
        Law or entry.
    vehicle
        Vehicle.
    scenario
        Sample time, delay and turbulence.
    amplitude
        [rad/s] rate that each sine would give the free body.
    seeds
        Seeds of the flights in turbulence.

    Raises
    ------
    DesignError
        If a flight breaks off, or the loop does not settle.

    Examples
    --------
    >>> from gustproof import load_law, load_scenario, load_vehicle
    >>> from gustproof.studies.operating_point import measure_operating_point
    >>> vehicle, scenario = load_vehicle("paper"), load_scenario("paper-turbulence")
    >>> found = measure_operating_point(load_law("pid-fair"), vehicle, scenario, seeds=())
    >>> f"Ms {found.Ms:.2f}, delay margin {1e3 * found.delay_margin:.0f} ms"
    'Ms 1.36, delay margin 38 ms'
    """
    found, quiet = (_respond(controller, vehicle, scenario, size) for size in (amplitude, _QUIETER * amplitude))
    changes = np.abs((1.0 + found.loops) / (1.0 + quiet.loops) - 1.0)
    return MeasuredPoint(
        controller=controller.name,
        vehicle=vehicle.name,
        scenario=scenario.name,
        axes=tuple(_margins(found.omega, loop) for loop in found.loops),
        slew=_fly_slew(controller, vehicle, scenario, seeds) if seeds else None,
        distortion=max(found.stray, float(np.sqrt(np.mean(changes**2, axis=1)).max())),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Response:
    """Loop transfer of the axes at the sines."""

    omega: Matrix
    """(n,) [rad/s] frequencies."""
    loops: ComplexMatrix
    """(3, n) loop transfer of each axis at the plant's input, negative feedback, the other axes closed."""
    stray: float
    """[-] largest share of an axis' command, rms, that is at no sine's frequency."""


def _respond(controller: Controller, vehicle: Vehicle, scenario: Scenario, amplitude: float) -> _Response:
    lines = _choose_lines(scenario)
    omega = 2.0 * math.pi / PERIOD_S * lines
    calm = _calm_scenario(vehicle, scenario)
    flights = [
        _fly(replace(calm, moment=_moments(vehicle, axis, omega, amplitude)), controller, vehicle) for axis in range(3)
    ]
    samples = round(PERIOD_S * scenario.control_rate_hz)
    rates, commands = (
        np.stack([_fourier(records[name][-samples:], lines) for records in flights], axis=2)
        for name in ("omega_B", "torque_command_B")
    )
    # u = K omega for three experiments at once: (n, commands, experiments) = K (n, rates, experiments)
    K = commands @ np.linalg.inv(rates)
    P = _fit_plant(flights, scenario.dt).response(omega)
    return _Response(
        omega=omega,
        loops=np.array([_close_others(-K @ P, axis) for axis in range(3)]),
        stray=max(
            _stray_share(records["torque_command_B"][-samples:, axis], lines) for axis, records in enumerate(flights)
        ),
    )


def _choose_lines(scenario: Scenario) -> Matrix:
    """Return the harmonics (n,) that are excited, in periods of `PERIOD_S`."""
    highest = _HIGHEST * 0.5 * scenario.control_rate_hz * PERIOD_S
    return np.unique(np.round(np.geomspace(1.0, highest, _LINES)))


def _calm_scenario(vehicle: Vehicle, scenario: Scenario) -> Scenario:
    """Return a scenario of the same rates and delay on the stand, in calm air, with perfect sensors."""
    x, y, z = vehicle.gyro.bias_B
    a, b, c = vehicle.accelerometer.bias_B
    return Scenario(
        name="frequency-response",
        description="sines about one axis, in calm air",
        duration_s=_SETTLING_S + PERIOD_S,
        altitude_m=scenario.altitude_m,
        control_rate_hz=scenario.control_rate_hz,
        physics_rate_hz=scenario.physics_rate_hz,
        delay_samples=scenario.delay_samples,
        gyro=GyroFault(bias_rad_s=(-x, -y, -z), noise=False),
        accelerometer=AccelerometerFault(bias_mps2=(-a, -b, -c), noise=False),
    )


def _moments(vehicle: Vehicle, axis: int, omega: Matrix, amplitude: float) -> tuple[MomentSine, ...]:
    """Return the sines about an axis, of random phases that are always the same."""
    phases = np.random.default_rng(axis).uniform(0.0, 2.0 * math.pi, omega.size)
    sines = []
    for w, phase in zip(omega.tolist(), phases.tolist(), strict=True):
        x, y, z = (amplitude * w * vehicle.inertia_B[axis] * np.eye(3)[axis]).tolist()
        sines.append(MomentSine(kind="sine", amplitude_nm=(x, y, z), rate_rad_s=w, phase_rad=phase))
    return tuple(sines)


def _fly(scenario: Scenario, controller: Controller, vehicle: Vehicle) -> Records:
    flight = fly_controller(scenario, controller, vehicle=vehicle)
    if flight.outcome is not FlightOutcome.DONE:
        raise DesignError(f"'{controller.name}' has no operating point on '{vehicle.name}': {flight.message}")
    samples = round(PERIOD_S * scenario.control_rate_hz)
    now, before = (flight.records["omega_B"][begin:][:samples] for begin in (-samples, -2 * samples))
    half = samples // 2
    if not np.linalg.norm((now - before)[half:]) <= _UNSTEADY * np.linalg.norm(now):
        raise DesignError(
            f"'{controller.name}' has no operating point on '{vehicle.name}': in calm air the loop does not settle"
        )
    return flight.records


def _fourier(signals: Matrix, lines: Matrix) -> ComplexMatrix:
    """Return the Fourier coefficients (n, 3) of a period (m, 3) at the lines (n,)."""
    return np.asarray(np.fft.rfft(signals, axis=0)[lines.astype(int)])


def _stray_share(signal: Matrix, lines: Matrix) -> float:
    """Return the share [-] of a period's rms (m,) that is at none of the lines (n,), without its mean."""
    power = np.abs(np.fft.rfft(signal)[1:]) ** 2
    return math.sqrt(float(np.sum(np.delete(power, lines.astype(int) - 1)) / np.sum(power)))


def _fit_plant(flights: Sequence[Records], dt: float) -> Lti:
    """Return the vehicle from command [N*m] to rates [rad/s], by least squares over all samples.

    States are rates and actuator torques. The records are free of noise, and moment and command are held over a
    sample: the fit is exact as far as the vehicle is linear.
    """
    before, after = [], []
    for records in flights:
        states = np.hstack([records["omega_B"], records["torque_B"]])
        before.append(np.hstack([states, records["torque_command_B"], records["moment_B"]])[:-1])
        after.append(states[1:])
    regressors = np.vstack(before)
    scale = np.linalg.norm(regressors, axis=0)
    found = np.linalg.lstsq(regressors / scale, np.vstack(after))[0] / scale[:, None]
    A, B = found[:6].T, found[6:9].T
    return Lti(A=A, B=B, C=np.eye(3, 6), D=np.zeros((3, 3)), dt=dt)


def _close_others(L: ComplexMatrix, axis: int) -> ComplexMatrix:
    """Return the loop transfer (n,) of an axis of `L` (n, 3, 3), the other two closed by negative feedback."""
    others = [k for k in range(3) if k != axis]
    rest = np.linalg.solve(np.eye(2) + L[:, others][:, :, others], L[:, others, axis][:, :, None])
    return np.asarray(L[:, axis, axis] - (L[:, axis, others][:, None] @ rest)[:, 0, 0])


def _margins(omega: Matrix, loop: ComplexMatrix) -> LoopMargins:
    """Return the margins of a loop transfer (n,), its logarithm interpolated by cubic splines over that of omega."""
    x, logarithm = np.log(omega), np.log(np.abs(loop)) + 1j * np.unwrap(np.angle(loop))
    spline = scipy.interpolate.CubicSpline(x, logarithm)
    grid = np.geomspace(omega[0], omega[-1], _FINE)
    values = np.exp(spline(np.log(grid)))
    return response_margins(
        grid, values, lambda w: complex(np.exp(spline(math.log(w)))), float(np.max(1.0 / np.abs(1.0 + values)))
    )


def _fly_slew(controller: Controller, vehicle: Vehicle, scenario: Scenario, seeds: Sequence[int]) -> float:
    squares = []
    for seed in seeds:
        flight = fly_controller(scenario, controller, vehicle=vehicle, seed=seed)
        if flight.outcome is not FlightOutcome.DONE:
            raise DesignError(f"'{controller.name}' has no operating point on '{vehicle.name}': {flight.message}")
        squares.append(measure(flight.records, vehicle, scenario).torque_slew_rms ** 2)
    return math.sqrt(float(np.mean(squares)))
