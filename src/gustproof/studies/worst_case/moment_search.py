"""Search for the worst disturbance within a budget, by simulation; the result is a scenario.

The search flies the nonlinear vehicle on the direct route, so the result flies over UDP to the same bits. It gives a
lower bound on the worst error, never an upper one. (MATLAB's `wcgain` searches the worst parameters of a linear model;
this searches the worst disturbance of the nonlinear one.)
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario, with_measured_delay
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import Dryden, Moment, MomentSine, MomentSquare, MomentStep
from firmware_model.types import Vector
from gustproof.design.loops.models import is_own_loop
from gustproof.flight.controllers.user_controller import Controller
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.flight import Flight
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.metrics import attitude, measure
from gustproof.law.form import Law
from gustproof.robust.shown import Shown
from gustproof.robust.uncertain.uncertainty import Spreads
from gustproof.studies.worst_case.starts import (
    AMPLITUDES,
    INERTIA,
    LAG,
    MAX_OMEGA,
    PHASES,
    RATE,
    SIZE,
    Point,
    random_point,
    randomize_vehicle,
    starts,
)

Array = NDArray[np.float64]
Records = NDArray[np.void]
Progress = Callable[[float], None]

PAPER_BUDGET: Vector = (0.65, 0.65, 0.3)
"""[N*m] B, disturbance moments of the paper, from its W_d."""
ENTRY_RATE_HZ = 250
"""[Hz] at which an entry is flown; a law has its own rate."""
_RANDOM_SHARE = 0.35  # of all flights
_MAX_SWITCHES = 30  # square waves cover loops that ring for longer
_LOCAL_SHARE = 0.5  # of the flights left after the starts; the rest goes to the best two


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class WorstCase(Shown):
    """The worst flight of a search.

    Examples
    --------
    >>> from gustproof import load_law, load_vehicle, worst_case
    >>> found = worst_case(load_law("hinf-d1"), vehicle=load_vehicle("paper"), duration_s=2.0, flights=100)
    >>> found.peak_deg >= found.start_deg
    True
    """

    scenario: Scenario
    """Script of the flight."""
    vehicle: Vehicle
    """Vehicle of the flight, varied within the spreads."""
    seed: int
    """Seed of the flight; matters only in turbulence."""
    peak_deg: float
    """[deg] largest magnitude of the Euler angles; infinite if they overflow."""
    peaks_deg: Vector
    """[deg] largest magnitudes of phi, theta, psi."""
    linear_deg: float
    """[deg] largest angle of the nominal vehicle's linear loop over all disturbances in the budget."""
    start: str
    """Name of the starting point that led to it."""
    start_deg: float
    """[deg] peak at the starting point."""
    flights: int
    """Number of simulated flights."""

    def lines(self) -> list[str]:
        """Return the peak and what causes it."""
        roll, pitch, yaw = self.peaks_deg
        return [
            f"{self.scenario.name}: the worst of {self.flights} flights",
            f"peak: {self.peak_deg:.3g} deg (roll {roll:.3g}, pitch {pitch:.3g}, yaw {yaw:.3g})",
            f"start: {self.start}, where the peak was {self.start_deg:.3g} deg",
            f"linear bound: {self.linear_deg:.3g} deg with the nominal vehicle at hover",
        ]


class _Candidate(NamedTuple):
    peak_deg: float
    point: Point
    start_deg: float


def worst_case(
    law: Controller,
    *,
    vehicle: Vehicle,
    budget: Vector = PAPER_BUDGET,
    spreads: Spreads | None = None,
    duration_s: float = 60.0,
    delay_samples: int = 1,
    flights: int = 500,
    seed: int = 1,
    progress: Progress | None = None,
) -> WorstCase:
    """Return the worst flight of a law or an entry that a search of about `flights` finds.

    Disturbances are direct moments with |moment| <= `budget` [N*m] B about each axis at all times: sines and square
    waves at multiples of a common rate, held moments, turbulence. Gyro noise is off, so that the moment alone causes
    the error. The same arguments give the same result to the bit. `progress` receives the fraction searched, 0..1.
    An entry flies at `ENTRY_RATE_HZ`; a flight that it does not fly to the end counts as one that diverges.

    Raises
    ------
    ConfigError
        If an entry can't be made.
    ValueError
        If a budget is not positive, or there are fewer than 100 flights. Also if, before the search, the law diverges
        or an entry breaks off in turbulence or under a moment held about one axis.

    Examples
    --------
    >>> from gustproof import load_law, load_vehicle, worst_case
    >>> found = worst_case(load_law("hinf-d1"), vehicle=load_vehicle("paper"), duration_s=2.0, flights=100)
    >>> f"{found.peak_deg:.1f} deg, in scenario '{found.scenario.name}'"
    "10.7 deg, in scenario 'worst-hinf-d1'"
    """
    if not all(math.isfinite(limit) and limit > 0.0 for limit in budget):
        raise ValueError(f"budget is {budget}, must be positive")
    if flights < 100:
        raise ValueError(f"flights are {flights}, must be at least 100")
    shown: Progress = progress or (lambda _: None)
    return _Search(law, vehicle, budget, spreads or Spreads(), duration_s, delay_samples, flights, seed, shown).run()


def peaks_deg(records: Records, scenario: Scenario, vehicle: Vehicle) -> Vector:
    """Return the largest magnitudes [deg] of phi, theta, psi; infinite after a flight that diverged or broke off."""
    if len(records) < scenario.samples:
        return (math.inf, math.inf, math.inf)
    flown = measure(records, vehicle, scenario)
    phi, theta, psi = np.nan_to_num((flown.peak_roll_deg, flown.peak_pitch_deg, flown.peak_yaw_deg), nan=math.inf)
    return float(phi), float(theta), float(psi)


class _Search:
    """One search: its settings and the count of its flights."""

    def __init__(
        self,
        law: Controller,
        vehicle: Vehicle,
        budget: Vector,
        spreads: Spreads,
        duration_s: float,
        delay_samples: int,
        flights: int,
        seed: int,
        progress: Progress,
    ) -> None:
        rate = round(1.0 / law.dt) if isinstance(law, Law) else ENTRY_RATE_HZ
        still = Scenario(
            name=f"worst-{law.name}",
            description="still air",
            duration_s=duration_s,
            control_rate_hz=rate,
            physics_rate_hz=rate * math.ceil(1000 / rate),
            delay_samples=delay_samples,
            gyro=GyroFault(noise=False),
            accelerometer=AccelerometerFault(noise=False),
        )
        own = isinstance(law, Law) and is_own_loop(law)
        self._base_scenario = with_measured_delay(still, vehicle, on_board=own)
        self._law, self._vehicle, self._budget, self._spreads = law, vehicle, np.array(budget), spreads
        self._slowest = math.pi / duration_s  # one change of sign in a flight
        self._flights, self._n_flights, self._seed, self._progress = flights, 0, seed, progress

    def run(self) -> WorstCase:
        rng = np.random.default_rng(self._seed)
        vehicles = self._corner_vehicles()
        responses = [self._step_responses(vehicle) for vehicle in vehicles]
        fixed = [(self._bang_bang(steps), vehicle) for steps, vehicle in zip(responses, vehicles, strict=True)]
        fixed.append((self._turbulence_scenario(), self._vehicle))
        steps = responses[0]
        points = [*starts(steps, self._budget, self._base_scenario.dt, self._slowest)]
        if self._spreads != Spreads():
            points += [randomize_vehicle(point, rng) for point in points]
        points += [random_point(f"random {k}", rng) for k in range(round(_RANDOM_SHARE * self._flights))]
        found = [self._evaluate(point) for point in points]
        for share, kept in ((_LOCAL_SHARE, 8), (1.0, 2)):
            best: dict[tuple[int, int, int], _Candidate] = {}  # one per pattern, so that not all climb one hill
            for one in sorted(found, key=lambda one: -one.peak_deg):
                best.setdefault(one.point.multiples, one)
            flights_each = int(share * (self._flights - self._n_flights) / kept)
            found = [self._climb(one, flights_each, rng) for one in list(best.values())[:kept]]
        return self._result(max(found, key=lambda one: one.peak_deg), fixed, steps)

    def _result(self, best: _Candidate, fixed: list[tuple[Scenario, Vehicle]], steps: Array) -> WorstCase:
        """Return the worst of the search's best flight and the `fixed` ones, which the search does not vary."""
        scenario, vehicle = self._scenario(best.point), self._airframe(best.point.x)
        start, start_deg = best.point.start, best.start_deg
        peaks_deg = self._peaks_deg(scenario, vehicle)
        for other, other_vehicle in fixed:
            others_deg = self._peaks_deg(other, other_vehicle)
            if max(others_deg) > max(peaks_deg):
                scenario, vehicle, peaks_deg = other, other_vehicle, others_deg
                start, start_deg = other.description, max(others_deg)
        return WorstCase(
            scenario=scenario,
            vehicle=vehicle,
            seed=self._seed,
            peak_deg=max(peaks_deg),
            peaks_deg=peaks_deg,
            linear_deg=_linear_peak_deg(steps, self._budget),
            start=start,
            start_deg=start_deg,
            flights=self._n_flights,
        )

    def _fly(self, scenario: Scenario, vehicle: Vehicle) -> Flight:
        self._n_flights += 1
        self._progress(min(self._n_flights / self._flights, 1.0))
        return fly_controller(scenario, self._law, vehicle=vehicle, seed=self._seed, nominal=self._vehicle)

    def _fly_finite(self, scenario: Scenario, vehicle: Vehicle) -> Records:
        """Return the records of a flight that the search starts from.

        Raises
        ------
        ValueError
            If the flight diverges or breaks off.
        """
        flight = self._fly(scenario, vehicle)
        records = flight.records
        if flight.outcome not in (FlightOutcome.DONE, FlightOutcome.DIVERGED):
            raise ValueError(f"controller '{self._law.name}' breaks off before the search: {flight.message}")
        if not (np.isfinite(records["q_NB"]).all() and np.isfinite(records["omega_B"]).all()):  # else it can be scored
            lag, inertia = vehicle.actuator_lag, ", ".join(f"{value:g}" for value in vehicle.inertia_B)
            raise ValueError(
                f"law '{self._law.name}' diverges on vehicle '{vehicle.name}' (inertia {inertia} kg m^2, lag {lag:g} "
                "s) before the search: the loop is unstable or the moment too large"
            )
        return records

    def _objective(self, point: Point) -> float:
        """Return the peak [deg] of a point's flight; 0 if its inertia is that of no rigid body."""
        vehicle = self._airframe(point.x)
        if 2.0 * max(vehicle.inertia_B) > sum(vehicle.inertia_B):
            return 0.0
        return max(self._peaks_deg(self._scenario(point), vehicle))

    def _peaks_deg(self, scenario: Scenario, vehicle: Vehicle) -> Vector:
        return peaks_deg(self._fly(scenario, vehicle).records, scenario, vehicle)

    def _evaluate(self, point: Point) -> _Candidate:
        peak_deg = self._objective(point)
        return _Candidate(peak_deg, point, peak_deg)

    def _climb(self, found: _Candidate, flights: int, rng: np.random.Generator) -> _Candidate:
        """Return the best of a random walk uphill: (1+1) evolution, steps longer after success, shorter after failure.

        References
        ----------
        I. Rechenberg, Evolutionsstrategie, 1973 (the one-fifth success rule).
        """
        size = 0.1
        for _ in range(flights):
            moved = found.point.x + size * rng.standard_normal(SIZE)
            moved[PHASES] %= 1.0
            point = found.point._replace(x=np.clip(moved, 0.0, 1.0))
            peak_deg = self._objective(point)
            better = peak_deg > found.peak_deg
            size *= 1.5 if better else 1.5**-0.25
            if better:
                found = found._replace(peak_deg=peak_deg, point=point)
        return found

    def _scenario(self, point: Point) -> Scenario:
        rate = self._slowest * (MAX_OMEGA / self._slowest) ** float(point.x[RATE])
        moments = []
        for axis, multiple in enumerate(point.multiples):
            amplitude = [0.0, 0.0, 0.0]
            amplitude[axis] = float(self._budget[axis] * point.x[AMPLITUDES][axis])
            phase = 2.0 * math.pi * float(point.x[PHASES][axis])
            if multiple:
                moments.append(_wave(point.square, amplitude, multiple * rate, phase))
            else:
                moments.append(_step(np.array(amplitude) * math.copysign(1.0, math.pi - phase)))
        return replace(self._base_scenario, description=f"found by search from: {point.start}", moment=tuple(moments))

    def _airframe(self, x: Array) -> Vehicle:
        factors = 1.0 + self._spreads.inertia * (2.0 * x[INERTIA] - 1.0)
        I_x, I_y, I_z = (factors * self._vehicle.inertia_B).tolist()
        lag = self._vehicle.actuator_lag * (1.0 + self._spreads.actuator_lag * (2.0 * float(x[LAG]) - 1.0))
        return replace(self._vehicle, inertia_B=(I_x, I_y, I_z), actuator_lag=lag)

    def _corner_vehicles(self) -> list[Vehicle]:
        """Return the nominal vehicle and, with spreads, light and heavy ones with small and large lag."""
        corners = [] if self._spreads == Spreads() else product((0.0, 1.0), repeat=2)
        return [self._vehicle, *(self._airframe(np.array([0.0] * 7 + [i, i, i, lag])) for i, lag in corners)]

    def _step_responses(self, vehicle: Vehicle) -> Array:
        """Return angles [rad] and rates [rad/s], (samples, 6, 3), per held moment of 1 N*m about each axis.

        A moment about one axis gives a plane rotation, so the response is that of the linear loop.
        """
        columns = []
        for axis in range(3):
            x = np.full(SIZE, 0.5)
            x[AMPLITUDES] = np.eye(3)[axis]
            x[PHASES] = 0.0
            records = self._fly_finite(self._scenario(Point("step", (0, 0, 0), True, x)), vehicle)
            columns.append(np.hstack([attitude(records), records["omega_B"]]) / self._budget[axis])
        return np.stack(columns, axis=2)

    def _bang_bang(self, steps: Array) -> Scenario:
        """Return the moments that move each angle of the linear loop most at the end, with their last switches only."""
        pulses = np.diff(steps[:, [0, 1, 2], [0, 1, 2]], axis=0, prepend=0.0)
        moments = []
        for axis in range(3):
            signs = np.where(pulses[::-1, axis] >= 0.0, 1.0, -1.0)
            switches = np.flatnonzero(np.diff(signs))[-_MAX_SWITCHES:] + 1
            full = self._budget * np.eye(3)[axis]
            moments.append(_step(full * (signs[switches[0] - 1] if switches.size else signs[0])))
            moments += [_step(2.0 * full * signs[k], int(k) * self._base_scenario.sample_us * 1e-6) for k in switches]
        return replace(self._base_scenario, description="bang-bang moments of the linear loop", moment=tuple(moments))

    def _turbulence_scenario(self) -> Scenario:
        """Return turbulence whose peak fills the budget on at least one axis."""
        gusty = Dryden(kind="dryden", wind_speed_20ft_mps=15.0, airspeed_mps=15.0)
        scenario = replace(self._base_scenario, description="Dryden turbulence that fills the budget", wind=(gusty,))
        peaks = np.max(np.abs(self._fly_finite(scenario, self._vehicle)["moment_B"]), axis=0)
        fill = 0.999 * float(np.min(self._budget / np.maximum(peaks, 1e-9)))  # below the budget despite rounding
        return replace(scenario, wind=(replace(gusty, wind_speed_20ft_mps=15.0 * fill),))


def _step(amplitude: Array, start: float = 0.0) -> MomentStep:
    L, M, N = (amplitude + 0.0).tolist()  # 0.0, not -0.0
    return MomentStep(kind="step", amplitude_nm=(L, M, N), start_s=start)


def _wave(square: bool, amplitude: list[float], rate: float, phase: float) -> Moment:
    L, M, N = amplitude
    if square:
        return MomentSquare(kind="square", amplitude_nm=(L, M, N), rate_rad_s=rate, phase_rad=phase)
    return MomentSine(kind="sine", amplitude_nm=(L, M, N), rate_rad_s=rate, phase_rad=phase)


def _linear_peak_deg(steps: Array, budget: Array) -> float:
    """Return the largest Euler angle [deg] of the linear loop under moments in the budget: its L1 norm."""
    norms = np.abs(np.diff(steps[:, :3], axis=0, prepend=0.0)).sum(axis=0)
    return math.degrees(float(np.max(norms @ budget)))
