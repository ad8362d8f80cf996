"""The wind that a vehicle stands with a law: turbulence in a mean wind, single gusts, and what is proved."""

import itertools
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.errors import ConfigError
from firmware_model.types import Vector
from gustproof.errors import FlightError
from gustproof.flight.routes.batch import Case, CaseResult, make_batch_simulator
from gustproof.flight.routes.kernels import LANES
from gustproof.law.form import Law
from gustproof.prove.boundedness import certify_made
from gustproof.studies.campaign.executors import Pool
from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.studies.campaign.plan import Campaign, DispersionKind, select_spreads, usual_dispersions
from gustproof.studies.campaign.rare import estimate_rare
from gustproof.studies.campaign.worker import load_campaign
from gustproof.studies.rate.plant_box import plant_box
from gustproof.studies.wind_limit.kept import MINUTE_S, Kept, needs_place, shares
from gustproof.studies.wind_limit.place import PlaceLoop, find_place_loop
from gustproof.studies.wind_limit.speed_search import (
    ESTIMATE_CONFIDENCE,
    RARE,
    SpeedEstimate,
    SpeedLimit,
    find_rare_limit,
    find_speed_limit,
    scout_speed,
)
from gustproof.studies.wind_limit.wind_flight import (
    find_tilt,
    gust_scenario,
    mean_wind,
    toward,
    tracks_references,
    wind_scenario,
)
from gustproof.types import Array, finite_or_none

LEAST, MOST = 0.5, 40.0
"""[m/s] wind speeds at 20 ft that are searched."""
DIRECTIONS = tuple(45.0 * k for k in range(8))
"""[deg] bearings that winds come from; the vehicle heads north."""
_VERTICAL = {"below": (0.0, 0.0, -1.0), "above": (0.0, 0.0, 1.0)}
_PLACE_LENGTHS = tuple(0.1 * 1.6**k for k in range(12))
"""[s] of 1-cos gusts, .1 to 17.6: a position loop is slower than an attitude."""
_LENGTHS = _PLACE_LENGTHS[:9]
"""[s] of those around a law alone, to 4.3."""
_CASES = 2**31
_CHUNK = 8 * LANES
_CELL = LANES  # flights at a point of the map
_SEEN, _MOST_SEEN = 10.0, 8 * _CHUNK  # failures that tell their causes, and flights for them
_PROOFS = 8  # tries for a wind whose tilt is within its limit
_AROUND, _HALVINGS = 1.6, 4  # [-] most that a direction's wind differs from the middle; to within 3 %
_MAP = tuple(0.28 * k for k in range(6))
_NAMES = ("the front", "front right", "the right", "back right", "the back", "back left", "the left", "front left")
_FIRST, _FAR = 1000, 0.01  # flights of each level of an estimate; [-] of the risk, below which it ends
Progress = Callable[[float, str], None]


class Broken(NamedTuple):
    """Event of a flight that breaks a requirement, see `studies.campaign.rare`."""

    kept: tuple[Kept, ...]
    """Requirements."""
    limit: float = 1.0
    """[-]."""
    figure: str = "largest figure over its limit"
    """Name of the value."""
    text: str = "a requirement is broken"
    """The event in words."""

    def value(self, result: CaseResult) -> float:
        """Return the largest figure of a flight over its limit [-]."""
        return max(shares(self.kept, result))


class GustLimit(NamedTuple):
    """Least 1-cos gust of one direction and length that fails."""

    source: str
    """Its origin, in words."""
    length_s: float
    """[s] from calm to calm."""
    speed: float
    """[m/s] at its peak; infinite if none up to `MOST` fails."""


class ProvedGust(NamedTuple):
    """Wind whose moment provably leaves the attitude in a box."""

    speed: float
    """[m/s] of gusts of any course; 0 without a proof."""
    attitude_deg: float
    """[deg] bound of roll and pitch."""
    note: str
    """Reason why there is no proof, or none for more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindLimit:
    """The wind that a vehicle stands with a law."""

    law: str
    """Name of the law."""
    vehicle: str
    """Name of the vehicle."""
    is_from_log: bool
    """True if the vehicle was identified from a log, which shows neither drag nor gust moment alone."""
    kept: tuple[Kept, ...]
    """Requirements."""
    risk: float
    """[-] accepted probability that a minute breaks one."""
    holds_place: bool
    """True if the law tilts into the mean wind; else it is carried along, and flies in turbulence alone."""
    place: PlaceLoop | None
    """Position loop that flies around the law; `None` if no drift is judged."""
    from_deg: float
    """[deg] worst bearing that the wind comes from, the vehicle heading north."""
    tilt_deg: float | None
    """[deg] roll or pitch that holds the place at the limit; `None` without one, or if nothing holds it."""
    turbulence: SpeedLimit
    """Limit as wind speed at 20 ft: of the mean wind, and of the turbulence that belongs to it."""
    directions: tuple[tuple[float, float], ...]
    """Bearing [deg], and the median of the largest figure over its limit [-] in wind from there."""
    direction_speed: float
    """[m/s] of that wind at 20 ft, in which about half of the flights from the front fail."""
    halves: tuple[tuple[float, float], ...]
    """Bearing [deg], and the wind from there [m/s] in which the median flight fails; empty without the map."""
    causes: tuple[tuple[str, float], ...]
    """Words, and the share [-] of failures above the limit in which each is most over its limit."""
    gusts: tuple[GustLimit, ...]
    """Least gust that fails of each direction, at its worst length."""
    lengths: tuple[GustLimit, ...]
    """Least gust that fails of the worst direction, at each length."""
    proved: ProvedGust
    """Certified part."""
    grid: tuple[tuple[float, float, float], ...]
    """Mean wind and turbulence [m/s] at 20 ft, and the share [-] of flights that fail; empty if not asked for."""
    scenario: Scenario | None
    """Flight in the least wind that is shown to be too much; `None` without one, or if no tilt holds the place."""
    calmer: Scenario
    """Flight in the strongest wind that was flown and could be held."""
    around: tuple[Scenario, ...]
    """Flights at the two ends of the limit and between, as far as they are known and can be held."""

    @property
    def shown_flight(self) -> Scenario:
        """Flight beyond the limit, or the nearest to it."""
        return self.scenario or self.calmer

    @property
    def worst_gust(self) -> GustLimit:
        """Least gust that fails."""
        return min(self.gusts, key=lambda each: each.speed)

    def to_dict(self) -> dict[str, Any]:
        """Return the limit as JSON values; numbers that are not finite become null."""
        limit, gust = self.turbulence, self.worst_gust
        return {
            "law": self.law,
            "vehicle": self.vehicle,
            "is_from_log": self.is_from_log,
            "keep": [each.text for each in self.kept],
            "risk_a_minute": self.risk,
            "holds_place": self.holds_place,
            "position_loop": None if self.place is None else self.place.to_dict(),
            "from_deg": self.from_deg,
            "tilt_deg": self.tilt_deg,
            "turbulence_mps": finite_or_none(limit.best),
            "shown_below_mps": limit.low,
            "shown_above_mps": limit.high,
            "flights": limit.flights,
            "gust_mps": finite_or_none(gust.speed),
            "gust_length_s": gust.length_s,
            "gust_from": gust.source,
            "proved_gust_mps": self.proved.speed,
            "proved_attitude_deg": finite_or_none(self.proved.attitude_deg),
            "proof_note": self.proved.note,
            "limited_by": dict(self.causes),
        }


def find_wind_limit(
    law: Law,
    vehicles: VehicleSet,
    base: Scenario,
    kept: Sequence[Kept],
    pool: Pool,
    *,
    risk: float,
    seed: int,
    with_map: bool = False,
    progress: Progress = lambda _share, _text: None,
) -> WindLimit:
    """Return the wind that a law stands on a vehicle and its spreads, with risk [-] a minute.

    `base` gives height, rates and delay. The same inputs give the same limit to the bit, on any pool.

    Raises
    ------
    ConfigError
        If drift is to be kept, and no position loop flies around the law, see `find_place_loop`.
    FlightError
        If a worker dies.
    """
    study = _Study(law, vehicles, base, tuple(kept), pool, seed)
    try:
        return _find(study, risk, progress, with_map=with_map)
    except pool.death_errors:
        raise FlightError("a worker died: out of memory, or installed differently") from None


def _find(study: "_Study", risk: float, progress: Progress, *, with_map: bool) -> WindLimit:
    middle = scout_speed(partial(study.failures, 0.0), least=LEAST, most=MOST)
    progress(0.05, f"directions at {middle:.1f} m/s")
    around = tuple((bearing, study.load(bearing, middle)) for bearing in DIRECTIONS)
    worst = max(around, key=lambda each: each[1])[0] if study.holds_place else 0.0
    told = itertools.count()

    def tell(text: str) -> None:
        progress(0.1 + 0.6 * (1.0 - 0.97 ** next(told)), text)

    limit = study.find_limit(worst, risk, tell)
    progress(0.75, "gusts")
    gusts, lengths = study.find_gusts()
    progress(0.8, "proof")
    proved = _below_failures(study.prove(), limit.high, min(each.speed for each in gusts))
    scale = limit.best if math.isfinite(limit.best) else MOST / 2.0
    progress(0.85, "map of mean wind and turbulence")
    return WindLimit(
        law=study.law.name,
        vehicle=study.vehicles.nominal.name,
        is_from_log=study.vehicles.nominal.command is not None,
        kept=study.kept,
        risk=risk,
        holds_place=study.holds_place,
        place=study.place,
        from_deg=worst,
        tilt_deg=study.tilt(limit.best, worst),
        turbulence=limit,
        directions=around,
        direction_speed=middle,
        halves=study.find_halves(middle) if with_map else (),
        causes=study.find_causes(worst, limit.often if risk < RARE else limit.high, max(risk, RARE)),
        gusts=gusts,
        lengths=lengths,
        proved=proved,
        grid=tuple(study.map_winds(worst, scale)) if with_map else (),
        scenario=None if limit.high is None else study.script(limit.high, worst),
        around=tuple(filter(None, (study.script(each, worst) for each in _ends(limit)))),
        calmer=next(filter(None, (study.script(each.speed, worst) for each in reversed(limit.trials)))),
    )


def _below_failures(proved: ProvedGust, wind: float | None, gust: float) -> ProvedGust:
    """Return what is proved no further than the least wind and the least gust [m/s] in which flights fail.

    The proof is of the attitude about level. The tilt that holds a place in mean wind is not part of it.
    """
    least = min(math.inf if wind is None else wind, gust)
    return proved if proved.speed < least else ProvedGust(least, proved.attitude_deg, "flights fail beyond")


def _ends(limit: SpeedLimit) -> list[float]:
    """Return the speeds [m/s] around a limit that are known."""
    return [each for each in (limit.low, limit.best, limit.high) if each is not None and math.isfinite(each)]


class _Study:
    """Law, vehicle and pool of one study; all flights are flown here."""

    def __init__(
        self, law: Law, vehicles: VehicleSet, base: Scenario, kept: tuple[Kept, ...], pool: Pool, seed: int
    ) -> None:
        self.law, self.vehicles, self.kept, self.holds_place = law, vehicles, kept, tracks_references(law)
        self._base, self._pool, self._seed = base, pool, seed
        self.place = find_place_loop(law, vehicles.nominal, base) if needs_place(kept) else None
        kinds = [kind for kind in usual_dispersions(vehicles) if kind is not DispersionKind.GUST]
        self._spreads = select_spreads(vehicles, base, kinds, gust=0.0, attitude_deg=0.0)

    def script(self, speed: float, from_deg: float) -> Scenario | None:
        """Return the flight in a wind [m/s] with the turbulence that belongs to it; `None` if it can't be held."""
        mean = speed if self.holds_place else 0.0
        return self._script(mean, speed, from_deg)

    def _script(self, mean: float, turbulence: float, from_deg: float) -> Scenario | None:
        vehicle = self.vehicles.nominal
        return wind_scenario(self._base, vehicle, self.kept, mean=mean, turbulence=turbulence, from_deg=from_deg)

    def tilt(self, speed: float, from_deg: float) -> float | None:
        """Return the larger of roll and pitch [deg] that hold the place in a wind, if they can and it is a limit."""
        if not (self.holds_place and math.isfinite(speed)):
            return None
        found = find_tilt(self.vehicles.nominal, mean_wind(speed, self._base.altitude_m), from_deg)
        return None if found is None else math.degrees(max(map(abs, found)))

    def failures(self, from_deg: float, speed: float, first: int, count: int) -> int:
        """Return how many of `count` flights in a wind fail; all if no tilt holds the place."""
        script = self.script(speed, from_deg)
        return count if script is None else int(np.sum(self._fly(script, first, count).max(axis=1) > 1.0))

    def find_limit(self, from_deg: float, risk: float, tell: Callable[[str], None]) -> SpeedLimit:
        """Return the wind from a bearing [deg] at which the probability of a failure is `risk` [-]."""
        fails = partial(self.failures, from_deg)
        if risk < RARE:
            estimate = partial(self.estimate, from_deg, least=_FAR * risk, tell=tell)
            return find_rare_limit(fails, estimate, risk=risk, least=LEAST, most=MOST, progress=tell)
        return find_speed_limit(fails, risk=risk, least=LEAST, most=MOST, progress=tell)

    def estimate(
        self, from_deg: float, speed: float, least: float = 0.0, tell: Callable[[str], None] = lambda _text: None
    ) -> SpeedEstimate:
        """Return the probability of a failure in a wind [m/s], level by level, 1 if no tilt holds the place.

        It is 0, with a bound, if it is less than `least`.
        """
        script = self.script(speed, from_deg)
        if script is None:
            return SpeedEstimate(IntervalEstimate(1.0, 1.0, 1.0), 0)
        campaign = replace(self._campaign(script), cases=_FIRST)
        found = estimate_rare(
            campaign,
            Broken(self.kept),
            self._pool,
            confidence=ESTIMATE_CONFIDENCE,
            least=least,
            progress=lambda share: tell(f"{speed:.2f} m/s, level by level: {100.0 * share:.0f} %"),
        )
        return SpeedEstimate(found.probability, found.flights)

    def load(self, from_deg: float, speed: float) -> float:
        """Return the median of the largest figure over its limit [-] in a wind; infinite if no tilt holds the place."""
        script = self.script(speed, from_deg)
        return math.inf if script is None else float(np.median(self._fly(script, 0, LANES).max(axis=1)))

    def find_halves(self, middle: float) -> tuple[tuple[float, float], ...]:
        """Return each bearing [deg] and its `half` [m/s]; none if the vehicle is carried along."""
        return tuple((each, self.half(each, middle)) for each in DIRECTIONS if self.holds_place)

    def half(self, from_deg: float, middle: float) -> float:
        """Return the wind [m/s] in which the median flight begins to fail, around a middle; infinite if none does."""
        low, high = middle / _AROUND, min(middle * _AROUND, MOST)
        if self.load(from_deg, high) <= 1.0:
            return math.inf
        for _ in range(_HALVINGS):
            between = math.sqrt(low * high)
            low, high = (low, between) if self.load(from_deg, between) > 1.0 else (between, high)
        return math.sqrt(low * high)

    def find_causes(self, from_deg: float, speed: float | None, risk: float) -> tuple[tuple[str, float], ...]:
        """Return words and their shares [-] of failures in a wind [m/s], the most frequent first."""
        if speed is None:
            return ()
        script = self.script(speed, from_deg)
        if script is None:
            return (("mean wind", 1.0),)
        ratios = self._fly(script, 0, min(_CHUNK * math.ceil(_SEEN / risk / _CHUNK), _MOST_SEEN))
        failed = ratios[ratios.max(axis=1) > 1.0]
        counts = Counter(self.kept[k].word for k in failed.argmax(axis=1))
        return tuple((word, number / len(failed)) for word, number in counts.most_common())

    def map_winds(self, from_deg: float, scale: float) -> Iterator[tuple[float, float, float]]:
        """Yield mean wind, turbulence, and the share of flights that fail, up to 1.4 times a speed [m/s]."""
        for mean in (share * scale for share in (_MAP if self.holds_place else (0.0,))):
            for turbulence in (share * scale for share in _MAP[1:]):
                script = self._script(mean, turbulence, from_deg)
                failed = 1.0 if script is None else np.mean(self._fly(script, 0, _CELL).max(axis=1) > 1.0)
                yield mean, turbulence, float(failed)

    def _fly(self, script: Scenario, first: int, count: int) -> Array:
        """Return each figure over its limit (count, kept) of flights from number `first` on."""
        campaign = self._campaign(script)
        metadata = json.dumps(campaign.metadata())
        parts = [(at, min(_CHUNK, first + count - at)) for at in range(first, first + count, _CHUNK)]
        return np.concatenate(list(self._run(fly_shares, [(metadata, self.kept, *part) for part in parts])))

    def _campaign(self, script: Scenario) -> Campaign:
        return Campaign(
            scenario=script,
            laws=(self.law,),
            vehicles=self.vehicles,
            spreads=self._spreads,
            cases=_CASES,
            seed=self._seed,
        )

    def _run(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield the results of a function on the pool, in order; at most `max_pending` tasks wait."""
        waiting = list[Future[Any]]()
        for task in tasks:
            waiting.append(self._pool.submit(function, *task))
            if len(waiting) >= self._pool.max_pending:
                yield waiting.pop(0).result()
        for each in waiting:
            yield each.result()

    def find_gusts(self) -> tuple[tuple[GustLimit, ...], tuple[GustLimit, ...]]:
        """Return the least gust that fails of each direction, and of the worst direction at each length."""
        script = gust_scenario(self._base, self.kept, length_s=1.0, direction=(1.0, 0.0, 0.0))
        metadata = json.dumps(self._campaign(script).metadata())
        sources = {name: toward(bearing) for name, bearing in zip(_NAMES, DIRECTIONS, strict=True)} | _VERTICAL
        lengths = _LENGTHS if self.place is None else _PLACE_LENGTHS
        tasks = [(metadata, self.kept, name, along, lengths) for name, along in sources.items()]
        found = dict(zip(sources, self._run(find_gust_limits, tasks), strict=True))
        each = {name: min(limits, key=lambda one: one.speed) for name, limits in found.items()}
        name, worst = min(each.items(), key=lambda one: one[1].speed)
        if math.isfinite(worst.speed):
            near = tuple(worst.length_s * 1.6 ** (0.25 * k) for k in (-3, -2, -1, 1, 2, 3))
            task = (metadata, self.kept, name, sources[name], near)
            (closer,) = self._run(find_gust_limits, [task])
            found[name] = sorted([*found[name], *closer], key=lambda one: one.length_s)
            each[name] = min(found[name], key=lambda one: one.speed)
        return tuple(each.values()), tuple(found[name])

    def prove(self) -> ProvedGust:
        """Return the strongest wind whose moment provably keeps the tilt within its limit, for a minute from rest."""
        limits = [each.limit for each in self.kept if each.word in ("tilt", "error")]
        if not limits:
            return ProvedGust(0.0, math.nan, "no angle is to be kept")
        if self._base.delay_samples != 1:
            return ProvedGust(0.0, math.nan, f"the check knows one sample of delay, not {self._base.delay_samples}")
        speed, note = MOST, ""
        for _ in range(_PROOFS):
            found = self._certify(speed)
            if isinstance(found, str):
                return ProvedGust(0.0, math.nan, found)
            part, angle = found
            if part < 1.0:
                note = "the proof's box ends there"
            if angle <= min(limits):
                return ProvedGust(math.floor(1e3 * part * speed) / 1e3, angle, note)
            share = min(limits) / angle
            note = "more tilt is possible beyond" if share else "the truth leaves the law's attitude too far beyond"
            speed *= 0.98 * part * share or 0.5 * part
        return ProvedGust(0.0, math.nan, "no proof was found")

    def _certify(self, speed: float) -> tuple[float, float] | str:
        """Return the part [-] of a wind [m/s] that is proved, and the bound of roll and pitch [deg]; or why none is.

        The bound is infinite if the true attitude has none.
        """
        vehicle, box = self.vehicles.nominal, plant_box(self.vehicles)
        spreads = box.shares()
        L, M, N = (speed * vehicle.gust_gain * np.array([1.0, 1.0, vehicle.gust_yaw_ratio])).tolist()
        try:
            found = certify_made(
                self.law,
                vehicle,
                moment=(L, M, N),
                horizon=MINUTE_S,
                inertia_spread=0.0 if box.assumed else spreads.inertia,
                lag_spread=0.0 if box.assumed else spreads.actuator_lag,
            )
        except ValueError as error:
            return str(error)
        bounds = [each for each in found.truth_deg or () if each is not None]
        if not found.proven or found.certified_fraction is None:
            return found.statement
        return found.certified_fraction, max(bounds[:2]) if len(bounds) > 1 else math.inf


def fly_shares(metadata: str, kept: Sequence[Kept], first: int, count: int) -> Array:
    """Return each figure of flights over its limit (count, kept) [-]; 0 for a vehicle that can't exist."""
    campaign = load_campaign(metadata)
    deltas, seeds = campaign.draw_deltas(first, count), campaign.flight_seeds(first, count)
    found, cases = np.zeros((count, len(kept))), dict[int, Case]()
    for i, (delta, seed) in enumerate(zip(deltas.tolist(), seeds, strict=True)):
        try:
            cases[i] = campaign.make_case(delta, seed)
        except ConfigError:
            continue
    with np.errstate(all="ignore"):  # a flight that diverges is a result
        results = make_batch_simulator(campaign.scenario, _law_of(campaign))(list(cases.values()))
    found[list(cases)] = [shares(kept, result) for result in results]
    return found


def find_gust_limits(
    metadata: str, kept: Sequence[Kept], source: str, direction: Vector, lengths: Sequence[float]
) -> list[GustLimit]:
    """Return the least gust that fails of each length [s], from one direction, on the nominal vehicle."""
    campaign, found = load_campaign(metadata), list[GustLimit]()
    vehicle = campaign.vehicles.nominal
    for length in lengths:
        script = gust_scenario(campaign.scenario, kept, length_s=length, direction=direction)
        simulate, low, high = make_batch_simulator(script, _law_of(campaign)), 0.0, MOST
        for _ in range(2):
            speeds = np.linspace(low, high, LANES + 1)[1:]
            cases = [Case(vehicle=vehicle, seed=campaign.seed, gust_scale=speed) for speed in speeds.tolist()]
            with np.errstate(all="ignore"):  # a flight that diverges is a result
                fails = [max(shares(kept, result)) > 1.0 for result in simulate(cases)]
            first = fails.index(True) if any(fails) else -1
            low, high = (speeds[first - 1] if first else low, speeds[first]) if first >= 0 else (high, math.inf)
            if first < 0:
                break
        found.append(GustLimit(source, length, float(high)))
    return found


def _law_of(campaign: Campaign) -> Law:
    law = campaign.laws[0]
    assert isinstance(law, Law)  # as this study makes it
    return law
