"""Requirements on a flight in wind, in words: tilt<35, saturated<1 %."""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from firmware_model.config.requirement import Metric
from firmware_model.config.validation import none_of
from firmware_model.errors import ConfigError
from gustproof.flight.routes.batch import CaseResult

MINUTE_S = 60.0
"""[s] length of the judged part of a flight; a share of time is of this."""
_TERM = re.compile(r"\s*(\w+)\s*<\s*([\d.eE+-]+)\s*(\S*)\s*")


class Word(NamedTuple):
    """Word of a requirement."""

    unit: str
    """Unit of its limit, which may be left out."""
    metric: Metric | None
    """Metric of the judged minute; `None` for a figure of the whole flight."""
    axis: str | None
    """Its axis; `None` for all."""
    about: str
    """Meaning."""


WORDS = {
    "tilt": Word(
        "deg",
        None,
        None,
        "largest roll or pitch, with the tilt that holds the place",
    ),
    "error": Word("deg", Metric.PEAK, None, "largest difference of an angle from its set-point"),
    "yaw": Word("deg", Metric.PEAK, "yaw", "largest yaw"),
    "rmse": Word("deg", Metric.RMSE, None, "rms difference of the angles from their set-points"),
    "saturated": Word("%", Metric.SATURATED, None, "share of a minute with a torque command at its limit"),
    "drift": Word("m", Metric.DRIFT, None, "largest distance from where the minute begins; a position loop flies"),
}
"""Words by name."""
_FROM_SET_POINTS = ("error", "rmse")  # of level, or of the tilt that holds a place: no position loop moves them


class Kept(NamedTuple):
    """One requirement."""

    word: str
    """Word of `WORDS`."""
    limit: float
    """[unit of the word] least value that fails."""

    @property
    def text(self) -> str:
        """The requirement as it is written."""
        return f"{self.word} < {self.limit:g} {WORDS[self.word].unit}"

    def tables(self, from_s: float, altitude: float) -> list[dict[str, object]]:
        """Return it as `[[require]]` tables, judged from a time [s] on; none for a figure of the whole flight.

        A drift has a second one, of the whole flight, half the `altitude` [m] or its own limit. A vehicle that lies on
        the ground before the judged part begins does not drift in it.
        """
        word = WORDS[self.word]
        if word.metric is None:
            return []
        limit = 0.01 * MINUTE_S * self.limit if word.unit == "%" else self.limit
        axis = {} if word.axis is None else {"axis": word.axis}
        found: list[dict[str, object]] = [{"metric": word.metric.value, "from_s": from_s, "at_most": limit, **axis}]
        if word.metric is Metric.DRIFT:
            found.append({"metric": word.metric.value, "at_most": max(limit, 0.5 * altitude)})
        return found


def parse_keep(text: str) -> tuple[Kept, ...]:
    """Return the requirements that are written as `WORD<LIMIT [UNIT]`, between commas.

    Raises
    ------
    ConfigError
        If one is written otherwise, has another unit, or is of what no flight in wind shows.
    """
    found = list[Kept]()
    for part in text.split(","):
        term = _TERM.fullmatch(part)
        try:
            limit = float(term[2]) if term else math.nan
        except ValueError:
            limit = math.nan
        if term is None or not 0.0 < limit < math.inf:
            raise ConfigError(f"--keep: '{part.strip()}' is no requirement such as 'tilt<35' or 'saturated<1 %'")
        word, unit = term[1], term[3]
        if word not in WORDS:
            raise ConfigError(f"--keep: {none_of(word, list(WORDS))}")
        if unit not in ("", WORDS[word].unit):
            raise ConfigError(f"--keep: {word} is in {WORDS[word].unit}, not in {unit}")
        if word in {each.word for each in found}:
            raise ConfigError(f"--keep: {word} stands twice")
        found.append(Kept(word, limit))
    _check_set_points(found)
    return tuple(found)


def _check_set_points(found: Sequence[Kept]) -> None:
    """Refuse what is from set-points, if a position loop moves these."""
    moved = [each.word for each in found if each.word in _FROM_SET_POINTS]
    if moved and needs_place(found):
        raise ConfigError(
            f"--keep: {moved[0]} is from set-points, which the position loop of drift moves: keep tilt, yaw"
        )


def needs_place(kept: Sequence[Kept]) -> bool:
    """Return whether a position loop has to fly around the law: drift is judged."""
    return any(each.word == "drift" for each in kept)


def shares(kept: Sequence[Kept], result: CaseResult) -> list[float]:
    """Return each figure of a flight over its limit [-], infinite if the flight diverged.

    The flight's scenario has the tables of `kept` as its requirements, in their order.
    """
    judged, figures = iter(result.requirements), result.metrics
    found = list[float]()
    for each in kept:
        if WORDS[each.word].metric is None:
            found.append(max(figures.peak_roll_deg, figures.peak_pitch_deg) / each.limit)
        else:
            values = [next(judged) for _ in each.tables(0.0, 0.0)]
            found.append(max(value.value / (value.requirement.at_most or 1.0) for value in values))
    return [math.inf if math.isnan(value) else value for value in found]
