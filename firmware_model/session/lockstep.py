"""Lockstep as it nearly always goes on: the set-point that answers a sample comes in, and the next sample goes out.

`FastPath` does at once what the endpoint does step by step, with the same result. Whatever is anything else it refuses
before it has changed anything: what happens then, and what a turn is to do, the endpoint's own way says.
"""

import math
from collections.abc import Iterable

from firmware_model.config.scenario import Scenario
from firmware_model.mavlink import messages
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Address
from firmware_model.mavlink.messages import CONTROLLER
from firmware_model.mavlink.peers import NEVER_US, Peer
from firmware_model.session.pacing import FlightClock
from firmware_model.types import AttitudeTarget, Command, TorqueCommand


class FastPath:
    """The turns that a vehicle in lockstep takes with the listener in command."""

    def __init__(self, flight: FlightClock, scenario: Scenario, system: int, *, possible: bool) -> None:
        self._flight, self._possible, self._source = flight, possible, (system, CONTROLLER)
        self._samples = messages.imu_template(system)
        self._torques, self._rates = messages.torque_template(system), messages.rate_template(system)
        self._last_us, self._sample_us = (scenario.samples - 1) * scenario.sample_us, scenario.sample_us
        self._commander: Peer | None = None
        self._end_us = 0
        self._taken = False

    def prepare(self, commander: Peer | None, listeners: Iterable[Peer]) -> None:
        """Find out whether nothing is to be done but to take turns, and up to when."""
        flight, self._commander = self._flight, None
        if commander is None or not self._possible or not commander.is_samples_only:
            return
        if not flight.asks() or flight.answered or flight.paused:
            return
        streams_us = min((listener.next_us for listener in listeners if listener is not commander), default=NEVER_US)
        ahead_us = streams_us - flight.clock_us(0) - self._sample_us
        self._commander, self._end_us = commander, min(flight.time_us + ahead_us, self._last_us)

    def take(self, datagram: bytes, peer: Address, now_us: int) -> bytes | None:
        """Fly the current sample as it is answered, and return the next one; `None`, and nothing done, if it is not."""
        flight, commander = self._flight, self._commander
        self._taken = False
        if commander is None:
            return None
        self._commander = None
        if peer != commander.address or flight.time_us >= self._end_us:
            return None
        command = self._command(datagram, commander.traffic)
        if command is None:
            return None
        commander.traffic.count_read(self._source)
        commander.last_seen_us = now_us
        flight.tick(now_us)
        flight.offer(command)
        flight.advance(now_us)
        sample = flight.loop.observe()
        self._commander, self._taken = commander, True
        return commander.traffic.make(self._samples, sample.time_us, *sample.specific_force_B, *sample.gyro_B)

    def taken(self) -> bool:
        """Whether a turn was taken since this was last asked, and nothing else has come since then."""
        taken, self._taken = self._taken, False
        return taken

    def _command(self, datagram: bytes, traffic: Channel) -> Command | None:
        """Return the set-point that answers the current sample, as `messages.command` does where nothing is clipped."""
        time_us = self._flight.time_us
        if isinstance(self._flight.setpoint, TorqueCommand):
            fields = traffic.read(self._torques, self._source, datagram)
            if fields is None:
                return None
            stamp_us, roll, pitch, yaw, throttle = fields
            fits = -1.0 <= roll <= 1.0 and -1.0 <= pitch <= 1.0 and -1.0 <= yaw <= 1.0 and math.isnan(throttle)
            return TorqueCommand(stamp_us, (roll, pitch, yaw), None) if fits and stamp_us == time_us else None
        fields = traffic.read(self._rates, self._source, datagram)
        if fields is None:
            return None
        stamp_ms, p, q, r, thrust = fields
        if stamp_ms != messages.boot_ms(time_us) or not (math.isfinite(p + q + r) and 0.0 <= thrust <= 1.0):
            return None
        return AttitudeTarget(stamp_ms * 1000, None, (p, q, r), thrust)
