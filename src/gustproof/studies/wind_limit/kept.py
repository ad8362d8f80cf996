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
}
"""Words by name."""


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

    def tables(self, from_s: float) -> list[dict[str, object]]:
        """Return it as a `[[require]]` table, judged from a time [s] on; none for a figure of the whole flight."""
        word = WORDS[self.word]
        if word.metric is None:
            return []
        limit = 0.01 * MINUTE_S * self.limit if word.unit == "%" else self.limit
        axis = {} if word.axis is None else {"axis": word.axis}
        return [{"metric": word.metric.value, "from_s": from_s, "at_most": limit, **axis}]


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
        if word == "drift":
            raise ConfigError("--keep: drift is not judged: no position loop flies around the law")
        if word not in WORDS:
            raise ConfigError(f"--keep: {none_of(word, list(WORDS))}")
        if unit not in ("", WORDS[word].unit):
            raise ConfigError(f"--keep: {word} is in {WORDS[word].unit}, not in {unit}")
        if word in {each.word for each in found}:
            raise ConfigError(f"--keep: {word} stands twice")
        found.append(Kept(word, limit))
    return tuple(found)


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
            value = next(judged)
            found.append(value.value / (value.requirement.at_most or 1.0))
    return [math.inf if math.isnan(value) else value for value in found]
