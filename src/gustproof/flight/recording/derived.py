"""Topics for viewers, which a bag holds beside the journal: Euler angles, requirements and events.

No reader of ours needs them: attitude and scenario say the same.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario
from firmware_model.config.timeline import timeline
from firmware_model.errors import ConfigError
from firmware_model.numerics.rotations import wrapped_euler_angles
from firmware_model.recording.journal import record_blocks

ANGLES_TYPE = np.dtype([("time_us", "<f8"), ("euler", "<f8", 3), ("reference", "<f8", 3), ("error", "<f8", 3)])
"""Layout of the angles [deg] of one sample."""
INFO = 20
"""Level of a log line that is no warning."""
EVENTS_TOPIC, REQUIREMENTS_TOPIC = "/events", "/requirements"


def angle_blocks(records: NDArray[np.void], scenario: Scenario | None) -> Iterator[NDArray[np.void]]:
    """Yield the angles of `ANGLES_TYPE` of the journal `records` (n,) in blocks; the reference is level by default.

    The error is the one that figures and requirements count: Euler angle minus reference, with yaw unwrapped.
    """
    unwrap = _Unwrapping()
    for block in record_blocks(records):
        angles = np.zeros(len(block), dtype=ANGLES_TYPE)
        angles["time_us"] = block["time_us"]
        euler = wrapped_euler_angles(block["q_NB"])
        euler[:, 2] = unwrap.continue_with(euler[:, 2])
        angles["euler"] = np.degrees(euler)
        for stamp, reference in () if scenario is None else scenario.references:
            angles["reference"][block["time_us"] >= stamp] = np.degrees(reference)
        angles["error"] = angles["euler"] - angles["reference"]
        yield angles


class _Unwrapping:
    """`np.unwrap` of angles [rad] that come in blocks, to the bit: corrections are summed in the same order."""

    def __init__(self) -> None:
        self._last: NDArray[np.float64] = np.empty(0)
        self._correction = np.array([-0.0])  # adds nothing, not even a sign

    def continue_with(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next angles (n,), n > 0, without jumps of half a turn or more."""
        step = np.diff(angles, prepend=self._last)
        within = np.mod(step + np.pi, 2.0 * np.pi) - np.pi
        within[(within == -np.pi) & (step > 0.0)] = np.pi
        corrections = np.where(np.abs(step) < np.pi, 0.0, within - step)
        sums = np.cumsum(np.concatenate([self._correction, corrections]))[-len(angles) :]
        self._last, self._correction = angles[-1:].copy(), sums[-1:]
        return np.asarray(angles + sums)


def parse_scenario(flight: Mapping[str, Any]) -> Scenario | None:
    """Return the scenario in a flight's metadata; `None` if they have none."""
    document = flight.get("scenario")
    if not isinstance(document, dict):
        return None
    try:
        return validate(Scenario, document, "scenario")
    except ConfigError:
        return None


def event_lines(scenario: Scenario, end_us: int) -> Iterator[tuple[int, str]]:
    """Yield stamp [us] and text of each gust, fault and event that begins or ends by `end_us`, in order of time."""
    lines = []
    for span in timeline(scenario):
        ends = (
            [(span.from_s, span.text)]
            if span.to_s <= span.from_s
            else [
                (span.from_s, f"{span.text} begins"),
                (span.to_s, f"{span.text} ends"),
            ]
        )
        lines += [(scenario.sample_at(time_s) * scenario.sample_us, text) for time_s, text in ends]
    yield from sorted(line for line in lines if line[0] <= end_us)


def requirement_fields(result: Mapping[str, Any], scenario: Scenario, end_us: int) -> tuple[int, tuple[Any, ...]]:
    """Return the stamp [us] of a requirement's `result` and the fields of its message after the header."""
    to_s = scenario.duration_s if result["to_s"] is None else result["to_s"]
    numbers = [math.nan if result[name] is None else result[name] for name in ("at_least", "at_most", "value")]
    fields = (
        result["metric"],
        result["axis"] or "",
        result["from_s"],
        to_s,
        *numbers,
        result["judged"],
        result["held"],
    )
    return min(round(to_s * 1e6), end_us), fields
