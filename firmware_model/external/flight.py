"""Conductor of an external autopilot's flight: bring-up until it holds the vehicle still, the scenario, the named end.

    stand    armed in its clamp, level, hover thrust -> clamp open, calm air, settled -> scenario
    free     armed on the ground, climbs to the scenario's height -> settled -> scenario

In all phases the autopilot follows attitude set-points; those of the scenario are the references of its events, level
before the first. In free flight their thrust holds the scenario's height by the true height, so that no autopilot's
own height loop makes a difference between two of them. The place is not held, as with a law of ours.
"""

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.firmware import hover_fraction
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.external.client import PERIOD_US, ExternalClient, describe_refusals, quote_last_texts
from firmware_model.external.interface import ExternalError, ExternalOutcome, ExternalProcess
from firmware_model.external.readings import Readings
from firmware_model.external.world import World
from firmware_model.numerics.rotations import from_euler, multiply
from firmware_model.recording.estimates import Estimate
from firmware_model.types import AXES, AttitudeTarget, Quaternion, Vector

_STILL_S = 3.0  # an autopilot that was still for this long has settled
_STILL_RATE = 0.03  # [rad/s] largest rate of a still vehicle, about three times that of a quantised gyro
_SETTLE_TIMEOUT_S = 40.0
_ONE_WAY = 0.5  # mean of a rate by its largest, above which it is a turn and no swing
_SWITCH_TIMEOUT_S = 3.0
_OVERTURNED = math.cos(math.radians(60.0))  # of the tilt, in calm air
_HEIGHT_TOLERANCE = 0.3  # [m]
_CLIMB_TIME_S = 30.0  # and a second for each metre
_RATE_OF_CLIMB = (-1.5, 2.0)  # [m/s]
_HEIGHT_P, _CLIMB_P, _CLIMB_I = 1.0, 3.0, 1.0  # [1/s], [1/s], [1/s^2]
_DECISION_US = 1_000_000  # between two looks at mode and arming: wall time may shift them by less than that
_SPIN_UP_TIMEOUT_S, _SPIN_UP_SHARE = 10.0, 0.9
_PROBE_S, _PROBE_ANGLE = 0.2, math.radians(4.0)
_PROBE_SHARE = 0.8  # of the torque's direction: axes that are crossed by more belong to another geometry


class ExternalFlight:
    """One flight of an autopilot in a world: `prepare`, then `fly`.

    `exchange` carries the client's datagrams, called with the world's time [us]. With True it waits until they have
    arrived: then two flights get the same set-point at the same sample. In the scenario the client's echo shows that,
    in a tenth of the time. `estimate` gets each attitude estimate of the scenario, on the scenario's clock.
    """

    def __init__(
        self,
        external: ExternalProcess,
        client: ExternalClient,
        world: World,
        vehicle: Vehicle,
        scenario: Scenario,
        *,
        exchange: Callable[[int, bool], None],
        estimate: Callable[[Estimate], None] = lambda _: None,
        wait: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._external, self._client, self._world = external, client, world
        self._vehicle, self._scenario = vehicle, scenario
        self._exchange, self._estimate, self._wait = exchange, estimate, wait
        self._references = list(scenario.references)
        self._initial = self._reference = _euler(scenario.initial_attitude_deg)
        self._height = TrueHeightLoop(vehicle, scenario)
        self._thrust = 0.0 if scenario.free else self._height.hover
        self._rotors: tuple[float, ...] = (0.0,) * 4
        self._readings = world.readings()
        self._interrupted = False
        self._fix_lost_us = 0
        self._client_at_us = 0

    def interrupt(self) -> None:
        """End the flight at the next sample."""
        self._interrupted = True

    def prepare(self) -> None:
        """Bring the started autopilot to hold the vehicle still, and begin the scenario.

        Raises
        ------
        ExternalError
            If the flight ends before that, with its outcome.
        """
        self._arm()
        if self._scenario.free:
            self._climb()
        else:
            self._probe()
        self._switch_law_on()
        self._world.release()
        self._settle()
        self._world.begin()
        self._client.take_estimates()

    def fly(self) -> None:
        """Fly the scenario to its end.

        Raises
        ------
        ExternalError
            If the flight ends before that, with its outcome.
        """
        while not self._world.finished:
            self._follow_script()
            self._follow_fix()
            self._step()
            self._check()

    def _arm(self) -> None:
        """Wait for the autopilot, send it set-points, set its mode, and arm it."""
        client, until_us = self._client, round(1e6 * self._external.arming_timeout_s)
        while self._world.time_us % _DECISION_US or not (
            client.is_armed and client.is_in_mode and self._external.is_armed
        ):
            has_warmed_up = client.autopilot is not None and self._world.time_us >= 1e6 * self._external.warm_up_s
            client.wants_flight = has_warmed_up and client.reader.finished
            self._step()
            if client.autopilot not in (None, self._external.dialect.autopilot):
                raise ExternalError(
                    ExternalOutcome.WRONG_BUILD, f"it is not {self._external.name}: MAV_AUTOPILOT {client.autopilot}"
                )
            if client.reader.finished and (faults := client.reader.describe_faults()):
                raise ExternalError(ExternalOutcome.WRONG_PARAMETERS, faults)
            if self._world.time_us >= until_us:
                waited = f"not armed in {self._external.dialect.mode_name} after {until_us / 1e6:g} s"
                raise ExternalError(ExternalOutcome.NOT_ARMED, f"{waited}: {describe_refusals(client)}")
        client.wants_flight = False

    def _probe(self) -> None:
        """Compare the torques of the rotors with those of small set-points about each axis, in the clamp."""
        self._spin_up()
        self._hold(1.0)
        for axis, name in enumerate(AXES):
            torque = np.zeros(3)
            for angle in (_PROBE_ANGLE, -_PROBE_ANGLE):
                turn = from_euler(*(angle if i == axis else 0.0 for i in range(3)))
                self._reference = multiply(self._initial, turn)
                torque += math.copysign(1.0, angle) * self._hold(_PROBE_S)
            self._reference = self._initial
            acceleration = torque / np.array(self._vehicle.inertia_B)
            if not acceleration[axis] > _PROBE_SHARE * float(np.linalg.norm(acceleration)):
                L, M, N = torque.tolist()
                said = f"a set-point in {name} gave torques of {L:.2f}, {M:.2f}, {N:.2f} N m"
                raise ExternalError(ExternalOutcome.WRONG_GEOMETRY, said)

    def _spin_up(self) -> None:
        """Wait until the rotors give about the thrust of the set-point."""
        until_us, hover = self._world.time_us + round(1e6 * _SPIN_UP_TIMEOUT_S), self._height.hover
        while (thrust := sum(self._rotors) / 4.0) < _SPIN_UP_SHARE * hover:
            self._step()
            self._check()
            if self._world.time_us > until_us:
                said = f"armed, but its rotors give {thrust:.2f} of their largest thrust, where {hover:.2f} is set"
                raise ExternalError(ExternalOutcome.NOT_ARMED, f"{said}: {describe_refusals(self._client)}")

    def _hold(self, seconds: float) -> NDArray[np.float64]:
        """Hold the set-point for a time, and return the last torque [N*m] of the rotors."""
        until_us = self._world.time_us + round(1e6 * seconds)
        while self._world.time_us < until_us:
            self._step()
            self._check()
        rotors = self._vehicle.rotors
        return np.asarray((rotors.wrench @ self._rotors)[:3] * rotors.thrust_max)

    def _climb(self) -> None:
        """Climb to the scenario's height."""
        height, until_us = self._scenario.altitude_m, self._world.time_us
        until_us += round(1e6 * (_CLIMB_TIME_S + height))
        while abs(height + self._readings.position_N[2]) > _HEIGHT_TOLERANCE:
            self._step()
            self._check(calm=True)
            if self._world.time_us > until_us:
                reached = f"at {-self._readings.position_N[2]:.1f} m, not {height:g} m, in time: "
                reached += "its hover thrust or its motors' curve is not this vehicle's"
                raise ExternalError(ExternalOutcome.UNSETTLED, reached)

    def _settle(self) -> None:
        """Wait until the vehicle has been still for a while."""
        still_us, until_us = self._world.time_us, self._world.time_us + round(1e6 * _SETTLE_TIMEOUT_S)
        rates: deque[Vector] = deque(maxlen=round(_STILL_S / self._scenario.dt))
        while self._world.time_us < still_us + 1e6 * _STILL_S:
            self._step()
            self._check(calm=True)
            rates.append(self._readings.omega_B)
            if max(map(abs, self._readings.omega_B)) > _STILL_RATE or not self._is_at_height():
                still_us = self._world.time_us
            if self._world.time_us > until_us:
                height = -self._readings.position_N[2] - self._scenario.altitude_m
                said = describe_unrest(np.array(rates), self._scenario.dt, height if self._scenario.free else 0.0)
                raise ExternalError(ExternalOutcome.UNSETTLED, f"after {_SETTLE_TIMEOUT_S:g} s it {said}")

    def _switch_law_on(self) -> None:
        """Give control to the law inside, if the autopilot's mode does not."""
        client, dialect = self._client, self._external.dialect
        client.wants_law, until_us = bool(dialect.law_switch), self._world.time_us + round(1e6 * _SWITCH_TIMEOUT_S)
        while client.wants_law:
            self._step()
            self._check()
            client.wants_law = dialect.law_is_on not in client.texts
            if self._world.time_us > until_us:
                raise ExternalError(
                    ExternalOutcome.WRONG_BUILD, f"no law inside takes control: {describe_refusals(client)}"
                )

    def _is_at_height(self) -> bool:
        off = self._scenario.altitude_m + self._readings.position_N[2]
        return not self._scenario.free or abs(off) < _HEIGHT_TOLERANCE

    def _follow_fix(self) -> None:
        """Tell an autopilot that simulates its own receiver whether the scenario gives it a fix."""
        had_fix, has_fix = not self._fix_lost_us, self._readings.has_fix
        if has_fix == had_fix:
            return
        self._fix_lost_us = 0 if has_fix else self._world.time_us
        self._client.set_parameters(
            {name: on if has_fix else off for name, on, off in self._external.dialect.fix_switches}
        )

    def _follow_script(self) -> None:
        time_us = self._world.loop.time_us
        while self._references and self._references[0][0] <= time_us:
            self._reference = from_euler(*self._references.pop(0)[1])

    def _step(self) -> None:
        """Exchange one sample with the autopilot, and let its client speak when it is due."""
        if self._interrupted:
            raise ExternalError(ExternalOutcome.INTERRUPTED, "interrupted")
        world, external = self._world, self._external
        readings = self._readings = world.readings()
        if readings.time_us >= self._client_at_us:
            self._client_at_us = readings.time_us + PERIOD_US
            self._speak(readings)
        self._wait(readings.time_us)
        external.send(readings)
        if world.overlaps:
            world.advance()
            if not world.finished:
                world.readings()  # the next ones, while the autopilot computes
        self._rotors = external.receive() or self._rotors
        world.answer(readings.time_us, self._rotors)
        if not world.overlaps:
            world.advance()

    def _speak(self, readings: Readings) -> None:
        client = self._client
        if self._scenario.free and client.is_armed and client.is_in_mode:
            self._thrust = self._height.thrust(readings)
        low, high = self._external.dialect.thrust_range
        thrust = min(max((self._thrust - low) / (high - low), 0.0), 1.0)
        before, client.target = client.target, AttitudeTarget(0, self._reference, None, thrust)
        flying = self._world.flying
        client.wants_echo = flying and client.target != before and self._external.arrival_s > 0.0
        self._exchange(readings.time_us, not flying)
        if flying:
            for each in client.take_estimates():
                if each.time_us >= self._world.started_us:
                    self._estimate(each._replace(time_us=each.time_us - self._world.started_us))

    def _check(self, *, calm: bool = False) -> None:
        """Name the end of a flight that the autopilot no longer flies."""
        client, (w, x, y, z) = self._client, self._readings.q_NB
        if not (client.is_armed and self._external.is_armed):
            raise self._give_up(ExternalOutcome.DISARMED, "disarmed; ")
        if not client.is_in_mode:
            left = f"left {self._external.dialect.mode_name} for mode {client.custom_mode}; "
            raise self._give_up(ExternalOutcome.LEFT_MODE, left)
        if calm and w * w - x * x - y * y + z * z < _OVERTURNED:
            raise ExternalError(
                ExternalOutcome.WRONG_GEOMETRY, "overturned in calm air: do its rotors stand as in the vehicle file?"
            )

    def _give_up(self, outcome: ExternalOutcome, what: str) -> ExternalError:
        """Return the end of a flight that the autopilot gave up, in its own words."""
        said = quote_last_texts(self._client)
        if not self._fix_lost_us:
            return ExternalError(outcome, said if outcome is ExternalOutcome.DISARMED else what + said)
        after_s = 1e-6 * (self._world.time_us - self._fix_lost_us)
        return ExternalError(ExternalOutcome.GPS_LOST, f"{after_s:.1f} s without a fix it {what}{said}")


def describe_unrest(omega_B: NDArray[np.float64], dt: float, height: float = 0.0) -> str:
    """Return how a vehicle moves that does not come to rest in calm air, and what such a motion comes from.

    `omega_B` (n, 3) [rad/s] are its rates at steps of `dt` [s], `height` [m] is that above the one it should hold.
    """
    if float(np.max(np.abs(omega_B))) <= _STILL_RATE:
        return f"is off its height by {height:+.1f} m: its hover thrust or its motors' curve is not this vehicle's"
    axis = int(np.argmax(np.sqrt(np.mean(omega_B**2, axis=0))))
    rate, name = omega_B[:, axis], AXES[axis]
    mean, largest = float(np.mean(rate)), float(np.max(np.abs(rate)))
    if abs(mean) > _ONE_WAY * largest:
        cause = "its rotors' geometry or spin is not this vehicle's, or its gains about that axis are too low"
        return f"turns one way about {name} at {mean:.2f} rad/s: {cause}"
    turns = np.flatnonzero(np.diff(np.signbit(rate - mean)))
    frequency = (len(turns) - 1) / (2.0 * dt * (turns[-1] - turns[0])) if len(turns) > 1 else 0.0
    cause = "its gains are too high, or its filters too slow, for this vehicle's inertia and lag"
    return f"swings about {name} at {frequency:.1f} Hz, by up to {largest:.2f} rad/s: {cause}"


class TrueHeightLoop:
    """Thrust that holds the scenario's height, by the true height; stepped once in `PERIOD_US`."""

    def __init__(self, vehicle: Vehicle, scenario: Scenario) -> None:
        self.hover = hover_fraction(vehicle)
        self._height, self._sum = scenario.altitude_m, 0.0

    def thrust(self, readings: Readings) -> float:
        """Return the collective thrust, 0..1 of the largest."""
        low, high = _RATE_OF_CLIMB
        climb = min(max(_HEIGHT_P * (self._height + readings.position_N[2]), low), high) + readings.velocity_N[2]
        limit = 0.3 * GRAVITY
        self._sum = min(max(self._sum + _CLIMB_I * climb * PERIOD_US * 1e-6, -limit), limit)
        return min(max(self.hover * (1.0 + (_CLIMB_P * climb + self._sum) / GRAVITY), 0.1), 0.95)


def _euler(degrees: Vector) -> Quaternion:
    phi, theta, psi = degrees
    return from_euler(math.radians(phi), math.radians(theta), math.radians(psi))
