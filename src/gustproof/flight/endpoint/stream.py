"""Stream of samples: request it at the law's rate, and measure the rate by the stamps."""

import math
from collections import deque
from statistics import fmean, median

from pymavlink.dialects.v20 import all as wire

_INTERVALS = 10  # between samples; their median gives the rate
_PATIENCE = 15  # requests without a sample before the next message is tried
_SLOWEST = 2.2  # [-] of the law's sample time: each sample then stands for two steps; a clock's error is far less


class SampleStream:
    """Samples of one autopilot, in the first of some messages that it sends, for a law that steps every `dt` [s]."""

    def __init__(self, law: str, dt: float, messages: tuple[int, ...]) -> None:
        self._law, self._dt, self._messages = law, dt, messages
        self.message_id = messages[0]
        self._requests = 0
        self._intervals_us: deque[int] = deque(maxlen=_INTERVALS)
        self._sampled_us: int | None = None
        self._is_granted = False
        self._declined: str | None = None

    @property
    def name(self) -> str:
        """Name of the message."""
        return str(wire.mavlink_map[self.message_id].msgname)

    @property
    def is_settled(self) -> bool:
        """True if the autopilot has answered the request for the rate."""
        return self._is_granted or self._declined is not None

    @property
    def interval_us(self) -> float:
        """[us] median time between samples, by their stamps; NaN before it is known."""
        return median(self._intervals_us) if len(self._intervals_us) > 1 else math.nan

    @property
    def is_flyable(self) -> bool:
        """True if the samples come often enough, or time stands."""
        return self._sampled_us == 0 or self.interval_us * 1e-6 < _SLOWEST * self._dt

    @property
    def is_refused(self) -> bool:
        """True if samples are too few, and the autopilot declines to send more."""
        return self._declined is not None and len(self._intervals_us) == _INTERVALS and not self.is_flyable

    def observe(self, time_us: int) -> None:
        """Take the stamp of a sample."""
        if self._sampled_us is not None:
            self._intervals_us.append(time_us - self._sampled_us)
        self._sampled_us = time_us

    def request(self) -> tuple[float, float] | None:
        """Return message and interval [us] to request, `None` if there is nothing to request."""
        has_none = self._sampled_us is None and (self._declined is not None or self._requests >= _PATIENCE)
        if has_none and self.message_id != self._messages[-1]:
            self.message_id = self._messages[self._messages.index(self.message_id) + 1]
            self._requests, self._is_granted, self._declined = 0, False, None
        self._requests += 1
        return None if self.is_settled else (float(self.message_id), round(1e6 * self._dt))

    def on_answer(self, *, accepted: bool, declined: str | None) -> None:
        """Take the answer to the request: accepted, declined with a reason, or neither of these yet."""
        if not self._is_granted:
            self._is_granted, self._declined = accepted, declined

    def describe(self) -> str:
        """Return in words how samples become steps of the law, unless each sample is one."""
        mean_s = 1e-6 * fmean(self._intervals_us or (0,))
        if mean_s == 0.0 or abs(mean_s / self._dt - 1.0) < 0.01:
            return ""
        return f"{self.name} comes every {1e3 * mean_s:.3g} ms: interpolated to the law's {1e3 * self._dt:g} ms"

    def describe_fault(self) -> str:
        """Return in words what is wrong with the samples; empty if they can be flown."""
        if math.isnan(self.interval_us):
            names = ", ".join(str(wire.mavlink_map[number].msgname) for number in self._messages)
            return f"no samples: the autopilot sends no {names} on this link"
        if self.is_flyable:
            return ""
        why = self._declined or "the autopilot does not change it on request"
        arrives, needs = f"{self.name} arrives at {1e6 / self.interval_us:.3g} Hz", f"needs {1.0 / self._dt:g} Hz"
        return f"{arrives}, law '{self._law}' {needs}: {why}"
