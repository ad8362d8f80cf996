"""Course of a scenario in time: gusts, moments, link faults and events, as spans with a name."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, Literal, NamedTuple

from firmware_model.config.fields import TimeWindow
from firmware_model.config.scenario import Scenario
from firmware_model.config.waveforms import Step

_SIDES = {
    ("gust", False): (("forward", "backward"), ("to the right", "to the left"), ("down", "up")),
    ("gust", True): (("to the north", "to the south"), ("to the east", "to the west"), ("down", "up")),
    ("moment", False): (("roll", "roll minus"), ("pitch", "pitch minus"), ("yaw", "yaw minus")),
    ("moment", True): (
        ("about north", "about north minus"),
        ("about east", "about east minus"),
        ("about down", "about down minus"),
    ),
}
"""Words for the two directions of each axis."""
_EVENT_ENDS = ("for_s", "over_s", "recovers_after_s")


class Span(NamedTuple):
    """One thing that happens in a flight."""

    from_s: float
    """[s] start."""
    to_s: float
    """[s] end; the start itself for a moment in time."""
    kind: Literal["gust", "moment", "link", "event"]
    """Table that it comes from."""
    text: str
    """Name for people."""


def timeline(scenario: Scenario) -> tuple[Span, ...]:
    """Return all that happens in part of the flight, by its start; what lasts from start to end is left out.

    A step that takes back an earlier one ends it.

    Examples
    --------
    >>> from firmware_model.config.scenario import load_scenario
    >>> timeline(load_scenario("gust-front"))[0].text
    'mode hold'
    >>> timeline(load_scenario("payload-drop"))[0].text
    'payload mass share -0.3; inertia share -0.18, -0.225, -0.45'
    """
    spans = [
        *_air(scenario, "gust", scenario.wind),
        *_air(scenario, "moment", scenario.moment),
        *(Span(*fault.span(scenario.duration_s), "link", f"link {_words(fault.kind)}") for fault in scenario.link),
        *(_event(event, scenario.duration_s) for event in scenario.event),
    ]
    parts = [span for span in spans if span.from_s < scenario.duration_s and not _is_whole(span, scenario)]
    return tuple(sorted(parts, key=lambda span: (span.from_s, span.to_s)))


def _is_whole(span: Span, scenario: Scenario) -> bool:
    return span.from_s <= 0.0 and span.to_s >= scenario.duration_s


def _air(scenario: Scenario, kind: Literal["gust", "moment"], tables: tuple[Any, ...]) -> Iterator[Span]:
    """Yield the spans of winds or moments."""
    last: list[tuple[Any, Span]] = []
    for table in tables:
        if not isinstance(table, TimeWindow):  # mean wind and continuous turbulence
            continue
        text = _strength(kind, table) + _words(str(getattr(table, "kind", "")))
        span = Span(*table.span(scenario.duration_s), kind, text)
        steps = isinstance(table, Step) and table.stop_s is None
        undone = next((i for i, (other, _) in enumerate(last) if steps and _takes_back(table, other)), None)
        if undone is None:
            last.append((table, span))
        else:
            last[undone] = (None, last[undone][1]._replace(to_s=span.from_s))
    yield from (span for _, span in last)


def _strength(kind: str, table: Any) -> str:
    """Return what blows or turns where, and how hard, before the course in time; a replay has only that."""
    if not hasattr(table, "vector"):
        return f"{kind} "
    vector: tuple[float, float, float] = table.vector
    sides, unit = _SIDES[kind, table.is_earth_frame], "m/s" if kind == "gust" else "N m"
    along = [
        f"{ends[0] if value > 0.0 else ends[1]} {abs(value):.3g}"
        for ends, value in zip(sides, vector, strict=True)
        if abs(value) > 1e-9 * max(map(abs, vector))  # a bearing's sine may miss 0
    ]
    return f"{kind} {', '.join(along)} {unit}, " if along else f"{kind} "


def _takes_back(table: Any, other: Any) -> bool:
    """Return whether a step is the opposite of an `other` that lasts."""
    return (
        isinstance(other, Step)
        and getattr(other, "stop_s", 0.0) is None
        and table.is_earth_frame == getattr(other, "is_earth_frame", None)
        and all(a == -b for a, b in zip(table.vector, getattr(other, "vector", ()), strict=True))
    )


def _event(event: Any, duration_s: float) -> Span:
    lasts = next((getattr(event, name) for name in _EVENT_ENDS if getattr(event, name, None)), 0.0)
    return Span(event.at_s, min(event.at_s + lasts, duration_s), "event", describe_event(event))


def describe_event(event: Any) -> str:
    """Return an event in a few words: its kind and its values, by name where there are several."""
    if event.kind == "mode":
        return f"mode {event.mode}"
    if event.kind == "attitude":
        return f"reference {_value(event.euler_deg) or '0'} deg"
    names = [each.name for each in fields(event) if each.name not in ("kind", "at_s", *_EVENT_ENDS)]
    shown = {_words(name): text for name in names if (text := _value(getattr(event, name)))}
    values = shown.values() if len(shown) == 1 else (f"{name} {text}" for name, text in shown.items())
    return " ".join((_words(event.kind), "; ".join(values))).strip()


def _value(value: Any) -> str:
    parts = value if isinstance(value, tuple) else (value,)
    if not any(parts):
        return ""
    return f"{parts[0]:g}" if len(set(parts)) == 1 else ", ".join(f"{part:g}" for part in parts)


def _words(name: str) -> str:
    return name.replace("_", " ")
