"""The wind that a vehicle stands, in lines of text."""

import math
from collections.abc import Iterator

from rich.text import Text

from gustproof.show.report.terminal import Renderable
from gustproof.studies.wind_limit.speed_search import CONFIDENCE, RARE, SpeedLimit
from gustproof.studies.wind_limit.wind_limit import LEAST, MOST, WindLimit


def render_wind_limit(found: WindLimit) -> Renderable:
    """Return the limit, its cause and what is proved."""
    return Text("\n".join([title(found), *describe_limit(found)]))


def title(found: WindLimit) -> str:
    """Return law, vehicle and requirements in a line."""
    return f"{found.law} on '{found.vehicle}': {', '.join(each.text for each in found.kept)}"


def describe_limit(found: WindLimit) -> Iterator[str]:
    """Yield the limit in turbulence, in single gusts, what is proved, and what limits."""
    yield f"wind: {describe_wind(found)}"
    if found.is_from_log:
        yield "it rests on drag and gust moment of the vehicle file: no log shows them, they are given or assumed there"
    if not found.holds_place:
        yield "the law has no set-points, so it can't tilt into the mean wind: it is carried along in turbulence"
    if found.place is not None:
        yield f"position: held by [position] of the vehicle file, {found.place.text}"
    if found.tilt_deg is not None:
        yield f"holding the place there takes {found.tilt_deg:.3g} deg of roll or pitch"
    yield f"1-cos gust: {describe_gust(found)}"
    proved = found.proved
    if proved.speed > 0.0:
        bound = f"roll and pitch within {proved.attitude_deg:.3g} deg of level for a minute"
        yield f"proved: {bound}, in any gust moment of wind up to {proved.speed:.3g} m/s; {proved.note}".rstrip("; ")
    else:
        yield f"proved: nothing; {proved.note}"
    if found.causes:
        causes = [f"{word} ({100.0 * share:.0f} % of failures)" for word, share in found.causes]
        where = "just above the limit" if found.risk >= RARE else "where they are frequent"
        yield f"limited by: {', then '.join(causes)}, {where}"


def describe_wind(found: WindLimit) -> str:
    """Return the limit in mean wind and its turbulence, with its interval."""
    limit, risk = found.turbulence, f"risk {found.risk:g} a minute"
    if limit.low == MOST:
        return f"none found: it stands {MOST:g} m/s at 20 ft ({risk})"
    if limit.high == LEAST:
        return f"it does not stand even {LEAST:g} m/s at 20 ft ({risk})"
    digits = _digits(limit)
    ends = [f"shown to stand {limit.low:.{digits}g}"] * (limit.low is not None)
    ends += [f"shown to fail at {limit.high:.{digits}g}"] * (limit.high is not None)
    source = f", from {found.from_deg:g} deg" if found.holds_place else ""
    counted = "" if found.risk >= RARE else " by subset simulation"
    told = f"{', '.join(ends) or 'neither side is shown'}, {100.0 * CONFIDENCE:g} %{counted}; {risk}{source}"
    best = f"up to {limit.best:.{digits}g} m/s at 20 ft" if math.isfinite(limit.best) else "the limit is not enclosed"
    return f"{best} ({told}; {limit.flights:,} flights)"


def _digits(limit: SpeedLimit) -> int:
    """Return the digits, three or more, that tell the two ends apart."""
    ends = limit.low, limit.high
    return next((n for n in (3, 4, 5) if None not in ends and f"{ends[0]:.{n}g}" != f"{ends[1]:.{n}g}"), 3)


def describe_gust(found: WindLimit) -> str:
    """Return the least single gust that fails."""
    worst = found.worst_gust
    if not math.isfinite(worst.speed):
        return f"none up to {MOST:g} m/s fails, from any of {len(found.gusts)} directions, in calm air"
    return f"{worst.speed:.3g} m/s fails at its worst length, {worst.length_s:.2g} s, from {worst.source}, in calm air"
