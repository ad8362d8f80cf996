"""Judgement of a law on a vehicle with spreads: verdict, margins, predicted error, worst gust, proof, failure."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from enum import Enum
from functools import partial
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.scenario import Scenario, with_measured_delay
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.vehicle import Vehicle
from firmware_model.types import AXES, Vector
from gustproof.airframe.covariance import axis_models
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.airframe.output_rounding import rounding_slew
from gustproof.airframe.predict import Prediction, predict
from gustproof.airframe.tradeoff import linear_laws
from gustproof.design.autopilot_gains import AutopilotTuning, tune_gains
from gustproof.design.loops.models import is_own_loop
from gustproof.design.structures import LawKind
from gustproof.design.tune import Tuning, default_slew, tune_law
from gustproof.errors import DesignError
from gustproof.law.form import Law, Output
from gustproof.prove.boundedness import FlightCertificate, certify_made
from gustproof.robust.lti.margins import LoopMargins, input_margins, worst_loop
from gustproof.robust.shown import Shown
from gustproof.studies.rate.advice import Advice, advise, autopilot_kind
from gustproof.studies.rate.failure_case import LOST_DEG, FailureCase, fly_failure, nearest_instability, spectral_radius
from gustproof.studies.rate.plant_box import PlantBox, describe_vehicle, plant_box
from gustproof.studies.rate.robustness import robust_peak
from gustproof.studies.worst_case.moment_search import WorstCase, worst_case

NOMINAL_PEAK, SPREAD_PEAK = 2.0, 2.5
"""[-] largest Ms of a sound law, nominal and over the spreads: 6 dB and 29 deg, 4.4 dB and 23 deg."""
SPARE_DELAY = 0.005
"""[s] least delay margin of a sound law over the spreads, on top of one sample: buses, mixer and motor drivers."""
_BUDGET = 3.0
"""[-] moment budget of the worst gust, in standard deviations of the air's moment."""
_FLIGHTS, _SEARCH_S = 150, 20.0
"""Flights of the search for the worst gust, and their length [s]."""
_MORE_SLEW = 1.25
"""[-] share of the law's torque slew that advice may add, where it has the vehicle's usual slew already."""
MOST_SLEW = 2.0
"""[-] most torque slew of better gains over that of the judged ones: motors get warm and wear by it."""
_TUNED_PEAKS = (1.4, 1.6)
"""[-] least and largest Ms of better gains."""
SAME = 5e-3
"""[-] relative change of error, slew and Ms within which gains are no better: three digits show none."""
_NO_CHECK = (
    "no bound of the attitude in every gust: commands act {} here, and the check has only loops in which they act one "
    "sample late. Stability and Ms over the spreads do not rest on it"
)
_UNSTABLE = "a vehicle within the spreads is unstable"

Progress = Callable[[float, str], None]


class Verdict(Enum):
    """Judgement in one word."""

    SOUND = "sound"
    """Stable over the spreads, with margins above the stated thresholds."""
    FRAGILE = "fragile"
    """Stable over the spreads, but a margin is below its threshold, or a gust in the budget costs the attitude."""
    UNSTABLE = "unstable"
    """A vehicle within the spreads is unstable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisJudgement:
    """Margins of one axis, the loop opened at the plant's input and the other axes closed."""

    nominal: LoopMargins
    """Margins with the nominal vehicle."""
    worst: LoopMargins
    """Worst of each margin at the corners of the spreads: sampled, not proved."""
    Ms_found: float
    """[-] largest sensitivity of any vehicle tried within the spreads."""
    Ms_proved: float | None
    """[-] bound of the sensitivity of every vehicle within the spreads; `None` if it is not proved."""
    rmse_deg: float
    """[deg] predicted error in the air."""
    slew: float
    """[N*m/s] predicted rms torque slew."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Judgement(Shown):
    """Verdict on a law, with its evidence.

    Examples
    --------
    >>> from gustproof import judge_law, load_law, load_scenario, load_vehicle_set
    >>> found = judge_law(load_law("pid-fair"), load_vehicle_set("iris"), load_scenario("paper-turbulence"))
    >>> found.reasons
    ('unstable with the nominal vehicle (5 of 5 tried are)',)
    """

    law: Law
    """Judged law."""
    vehicle: Vehicle
    """Nominal vehicle."""
    box: PlantBox
    """Vehicles that it is judged over."""
    scenario: Scenario
    """Air, sample rate and delay."""
    verdict: Verdict
    """Judgement in one word."""
    reasons: tuple[str, ...]
    """Grounds of the verdict, each with its threshold."""
    axes: tuple[AxisJudgement, ...]
    """Roll, pitch and yaw; empty if the nominal vehicle is unstable."""
    predicted: Prediction | None
    """Error and slew in the air; `None` if the nominal vehicle is unstable."""
    slew: float | None
    """[N*m/s] predicted torque slew with that of rounded outputs; `None` as before."""
    worst_rmse_deg: float | None
    """[deg] largest predicted error at the corners of the spreads; `None` as before, or if a corner is unstable."""
    least_rmse_deg: float | None
    """[deg] least error of linear gyro-only laws at the same Ms and slew; `None` if none was found."""
    budget: Vector
    """[N*m] B, moment within which the worst gust is searched and the proof is tried."""
    gust: WorstCase | None
    """Worst flight found in the budget; `None` if the law was not searched."""
    gust_note: str
    """Reason why there is no worst flight; empty if there is one."""
    proof: FlightCertificate | None
    """Certificate of the attitude's bound in the budget, over the spreads; `None` if it does not apply."""
    proof_note: str
    """Reason why there is no certificate; empty if there is one."""
    failure: FailureCase | None
    """Nearest unstable case, flown; `None` if none was found."""
    advice: tuple[Advice, ...]
    """Changes of an autopilot's parameters that matter most; empty for another law."""

    def lines(self) -> list[str]:
        """Return the verdict with its reasons, margins, error, the worst gust and the proof."""
        spread = "proved" if self.is_proved else "sampled"
        return [
            f"{self.law.name} on vehicle {self.vehicle.name}: {self.verdict.value}",
            *(f"reason: {reason}" for reason in self.reasons),
            *([] if self.Ms is None else [f"Ms: {self.Ms:.3g}, {self.Ms_over_spreads:.3g} over the spreads, {spread}"]),
            *(
                []
                if self.predicted is None
                else [f"error: {self.rmse_deg:.3g} deg rms expected, slew {self.slew:.3g} N m/s"]
            ),
            *([] if self.gust is None else [f"worst gust found: {self.gust.peak_deg:.3g} deg"]),
            *([] if self.proof is None else [f"{self.proof.verdict}: {self.proof.claim}"]),
        ]

    @property
    def Ms(self) -> float | None:
        """Largest nominal sensitivity [-] of the axes; `None` if the nominal vehicle is unstable."""
        return max((axis.nominal.Ms for axis in self.axes), default=None)

    @property
    def rmse_deg(self) -> float | None:
        """Predicted error [deg]; `None` as `Ms`."""
        return None if self.predicted is None else math.degrees(self.predicted.rmse)

    @property
    def seen_rmse_deg(self) -> float | None:
        """Predicted error [deg] of the law's own attitude; `None` as `Ms`, and for a law without one."""
        seen = None if self.predicted is None else self.predicted.seen_rmse
        return None if seen is None else math.degrees(seen)

    @property
    def Ms_over_spreads(self) -> float | None:
        """Largest sensitivity [-] over the spreads, proved where it is; `None` as `Ms`."""
        return max((axis.Ms_proved or axis.Ms_found for axis in self.axes), default=None)

    @property
    def is_proved(self) -> bool:
        """True if stability over the spreads is proved, for all three axes."""
        return bool(self.axes) and all(axis.Ms_proved is not None for axis in self.axes)

    def to_dict(self) -> dict[str, Any]:
        """Return the judgement as JSON values; numbers that are not finite become `None`."""
        document = {
            "law": self.law.name,
            "vehicle": self.vehicle.name,
            "scenario": self.scenario.name,
            "verdict": self.verdict.value,
            "reasons": self.reasons,
            "stability_over_spreads": "proved" if self.is_proved else "sampled",
            "spreads": {key: value for key, value in asdict(self.box).items() if key != "nominal"},
            "axes": {name: asdict(axis) for name, axis in zip(AXES, self.axes, strict=False)},
            "Ms": self.Ms,
            "rmse_deg": self.rmse_deg,
            "seen_rmse_deg": self.seen_rmse_deg,
            "slew": self.slew,
            "worst_rmse_deg": self.worst_rmse_deg,
            "least_rmse_deg": self.least_rmse_deg,
            "budget_nm": self.budget,
            "worst_gust": None if self.gust is None else {"peak_deg": self.gust.peak_deg, "start": self.gust.start},
            "worst_gust_note": self.gust_note,
            "proof": None
            if self.proof is None
            else {
                "proven": self.proof.is_whole,
                "part": self.proof.certified_fraction,
                "statement": self.proof.statement,
            },
            "proof_note": self.proof_note,
            "failure": self.failure and self.failure.describe(),
            "advice": [{"text": each.describe(), **asdict(each)} for each in self.advice],
        }
        finite: dict[str, Any] = to_jsonable_python(document, inf_nan_mode="null")
        return finite


def scenario_for(law: Law, vehicle: Vehicle, scenario: Scenario) -> Scenario:
    """Return the scenario at the sample rate of `law`, its delay the same number of samples, or as measured."""
    rate = round(1.0 / law.dt)
    day = replace(scenario, control_rate_hz=rate, physics_rate_hz=rate * math.ceil(1000 / rate))
    return with_measured_delay(day, vehicle, on_board=is_own_loop(law))


def judge_law(
    law: Law,
    vehicles: VehicleSet,
    scenario: Scenario,
    *,
    moment: Vector | None = None,
    thrust_step: float = 0.0,
    seed: int = 1,
    progress: Progress = lambda _share, _text: None,
) -> Judgement:
    """Judge a torque law on a vehicle and its spreads of inertia and lag, in the turbulence of a scenario.

    For a law of three loops of one gyro each, the bound of Ms over the spreads is proved, and with it stability (see
    `robust_peak`). The damping is that in their middle. Otherwise corners of the spreads are sampled.

    Parameters
    ----------
    law
        Law, at its own sample rate.
    vehicles
        Vehicle with its spreads.
    scenario
        Turbulence and delay in samples.
    moment
        (3,) [N*m] B, budget of the worst gust and of the proof; `air_budget` by default.
    thrust_step
        [N] step in which an autopilot tells a rotor's thrust, see `gustproof.airframe.output_rounding`.
    seed
        Seed of the search and of the flights.
    progress
        Function of the share done and a text.

    Raises
    ------
    ValueError
        If the law commands no torque, or the scenario has no turbulence.

    Examples
    --------
    >>> from gustproof import judge_law, load_law, load_scenario, load_vehicle_set
    >>> found = judge_law(load_law("flagship"), load_vehicle_set("paper"), load_scenario("paper-turbulence"))
    >>> (found.verdict.value, found.is_proved)
    ('sound', True)
    """
    if law.output is not Output.TORQUE:
        raise ValueError(f"law '{law.name}' commands rates: its loop is the autopilot's own")
    vehicle, box = vehicles.nominal, plant_box(vehicles)
    scenario = scenario_for(law, vehicle, scenario)
    budget, usual = moment or air_budget(vehicle, scenario), default_slew(vehicle, scenario)
    progress(0.0, "step 1 of 4: margins over the spreads")
    tried = [vehicle, *box.corners()]
    unstable = [each for each in tried if spectral_radius(law, each, scenario) >= 1.0]
    predicted, axes = _judge_axes(law, box, unstable, scenario)
    edge = nearest_instability(law, box, scenario)
    if edge is not None and edge.times <= 1.0 and not unstable:  # stable at the corners, but not between them
        unstable.append(edge.vehicle())
    progress(0.2, "step 2 of 4: worst gust")
    gust, gust_note = _search(law, box, unstable, budget, scenario, seed)
    progress(0.4, "step 3 of 4: proof")
    proof, proof_note = _prove(law, box, unstable, budget, scenario)
    progress(0.8, "step 4 of 4: failure and advice")
    delays = min((axis.nominal.delay_margin for axis in axes), default=math.inf), scenario.dt + SPARE_DELAY
    found = Judgement(
        law=law,
        vehicle=vehicle,
        box=box,
        scenario=scenario,
        verdict=Verdict.SOUND,
        reasons=(),
        axes=axes,
        predicted=predicted,
        slew=None if predicted is None else whole_slew(predicted, vehicle, thrust_step, scenario),
        worst_rmse_deg=None if unstable else _worst_error(law, tried, scenario),
        least_rmse_deg=_least_error(axes, predicted, vehicle, scenario),
        budget=budget,
        gust=gust,
        gust_note=gust_note,
        proof=proof,
        proof_note=proof_note,
        failure=fly_failure(law, box, unstable, edge, delays, scenario, seed),
        advice=(),
    )
    advice = advise(law, vehicle, scenario, slew=max(usual, _MORE_SLEW * (found.slew or 0.0)))
    verdict, reasons = _conclude(found, len(tried), unstable)
    return replace(found, verdict=verdict, reasons=reasons, advice=advice)


def improve(found: Judgement, vehicles: VehicleSet) -> AutopilotTuning | Tuning | None:
    """Return gains of least error at the Ms and slew of those judged, or at usual ones.

    The usual slew is `default_slew`, but at most `MOST_SLEW` times that of the judged gains. For an autopilot's loops
    these are its own parameters, beside the notches that are judged, for another law a flagship. It is `None` if none
    are found, or only those judged, or if sound gains had neither less error nor less Ms.
    """
    kind = autopilot_kind(found.law)
    flown = found.law.provenance.parameters
    search = partial(tune_gains, kind, flown=flown) if kind else partial(tune_law, LawKind.FLAGSHIP)
    usual, (low, high) = default_slew(found.vehicle, found.scenario), _TUNED_PEAKS
    if found.slew:
        usual = min(usual, MOST_SLEW * found.slew)
    slew, Ms = max(usual, found.slew or 0.0), min(max(found.Ms or low, low), high)
    for point in dict.fromkeys(((slew, Ms), (slew, low), (usual, low))):
        try:
            tuned = search(vehicles, found.scenario, slew=point[0], sensitivity_peak=point[1])
        except DesignError:  # too tight, or the search fails from each of its starts
            continue
        if tuned.slew <= (1.0 + SAME) * point[0]:  # more where rounded outputs alone take nearly all of it
            return tuned if _is_better(found, tuned) else None
    return None


def _is_better(found: Judgement, tuned: AutopilotTuning | Tuning) -> bool:
    """Return False for the judged gains again, and where those are sound and neither error nor Ms gets less."""
    if found.Ms is None or found.slew is None or found.rmse_deg is None:
        return True
    Ms, slew, error = tuned.Ms / found.Ms, tuned.slew / found.slew, math.degrees(tuned.rmse) / found.rmse_deg
    if all(math.isclose(ratio, 1.0, rel_tol=SAME) for ratio in (Ms, slew, error)):
        return False
    return found.verdict is not Verdict.SOUND or min(Ms, error) < 1.0 - SAME


def air_budget(vehicle: Vehicle, scenario: Scenario) -> Vector:
    """Return three standard deviations [N*m] B of the moment of the scenario's turbulence.

    Raises
    ------
    ValueError
        If the scenario has no turbulence.
    """
    models = axis_models(vehicle, scenario)
    variances = (float((model.gust.C @ model.gust_covariance @ model.gust.C.T)[0, 0]) for model in models)
    L, M, N = (_BUDGET * math.sqrt(variance) for variance in variances)
    return L, M, N


def _judge_axes(
    law: Law, box: PlantBox, unstable: Sequence[Vehicle], scenario: Scenario
) -> tuple[Prediction | None, tuple[AxisJudgement, ...]]:
    """Return prediction and margins; `None` and empty if the nominal vehicle is unstable."""
    predicted = None if box.nominal in unstable else predict(law, box.nominal, scenario)
    if predicted is None:
        return None, ()
    K, gravity_aided = loop_law(law), law.uses_accelerometer
    tried = [box.nominal, *(each for each in box.corners() if each not in unstable)]
    sampled = [input_margins(hover_plant(each, scenario, with_attitude=gravity_aided), K) for each in tried]
    found = []
    for axis in range(3):
        loops = [each[axis] for each in sampled]
        worst, bound = worst_loop(loops), None
        peak = math.inf if unstable else worst.Ms
        try:
            centre, spreads = box.centre(axis)
            bracket = robust_peak(law, centre, scenario, spreads, axis)
        except ValueError:  # not a loop of one gyro, or the middle of the spreads is unstable
            pass
        else:
            peak, bound = max(peak, bracket.lower), bracket.upper if math.isfinite(bracket.upper) else None
        found.append(
            AxisJudgement(
                nominal=loops[0],
                worst=worst,
                Ms_found=peak,
                Ms_proved=bound,
                rmse_deg=math.degrees(predicted.axes_rmse[axis]),
                slew=predicted.axes_slew[axis],
            )
        )
    return predicted, tuple(found)


def whole_slew(predicted: Prediction, vehicle: Vehicle, thrust_step: float, scenario: Scenario) -> float:
    """Return the predicted torque slew [N*m/s] with that of outputs rounded to a step of a rotor's thrust [N]."""
    return math.hypot(predicted.slew, rounding_slew(predicted.axes_slew, vehicle.rotors, thrust_step, scenario.dt))


def _worst_error(law: Law, corners: list[Vehicle], scenario: Scenario) -> float:
    found = [predict(law, each, scenario) for each in corners]
    return max(math.degrees(each.rmse) for each in found if each is not None)


def _least_error(
    axes: tuple[AxisJudgement, ...], predicted: Prediction | None, vehicle: Vehicle, scenario: Scenario
) -> float | None:
    if predicted is None:
        return None
    try:
        laws = linear_laws(axis_models(vehicle, scenario), around=predicted.slew)
        return math.degrees(laws.minimize_error(max(axis.nominal.Ms for axis in axes), predicted.slew).rmse)
    except (DesignError, ValueError, np.linalg.LinAlgError):  # no such law was found, or the law commands nothing
        return None


def _search(
    law: Law, box: PlantBox, unstable: Sequence[Vehicle], budget: Vector, scenario: Scenario, seed: int
) -> tuple[WorstCase | None, str]:
    """Return the worst flight found over the spreads, or the reason why there is none."""
    if unstable:
        return None, _UNSTABLE
    try:
        found = worst_case(
            law,
            vehicle=box.centre(0)[0],
            budget=budget,
            spreads=box.widest(),
            duration_s=_SEARCH_S,
            delay_samples=scenario.delay_samples,
            flights=_FLIGHTS,
            seed=seed,
        )
    except ValueError as error:
        return None, str(error)
    return found, ""


def _prove(
    law: Law, box: PlantBox, unstable: Sequence[Vehicle], budget: Vector, scenario: Scenario
) -> tuple[FlightCertificate | None, str]:
    """Return the certificate of the attitude's bound over the spreads, or the reason why there is none."""
    if unstable:
        return None, _UNSTABLE
    if scenario.delay_samples != 1:
        return None, _NO_CHECK.format(f"{scenario.delay_samples} samples late" if scenario.delay_samples else "at once")
    spreads = box.shares()
    try:
        found = certify_made(
            law,
            box.nominal,
            moment=budget,
            horizon=scenario.duration_s,
            inertia_spread=spreads.inertia,
            lag_spread=spreads.actuator_lag,
        )
    except ValueError as error:
        return None, str(error)
    return found, ""


def _conclude(found: Judgement, corners: int, unstable: list[Vehicle]) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict and its reasons."""
    if unstable:
        nominal = found.vehicle in unstable
        first = "the nominal vehicle" if nominal else f"a vehicle within the spreads: {describe_vehicle(unstable[0])}"
        return Verdict.UNSTABLE, (f"unstable with {first} ({len(unstable)} of {corners} tried are)",)
    least = found.scenario.dt + SPARE_DELAY
    reasons = []
    for name, axis in zip(AXES, found.axes, strict=True):
        reasons += [f"{name}: {reason}" for reason in _find_weakness(axis, least)]
    if found.gust is None:
        reasons.append(f"gusts: {found.gust_note}")
    elif max(found.gust.peaks_deg[:2]) > LOST_DEG:
        reasons.append(f"a gust within the budget costs the attitude: {max(found.gust.peaks_deg[:2]):.3g} deg")
    if reasons:
        return Verdict.FRAGILE, tuple(reasons)
    how = "proved for all of them" if found.is_proved else f"sampled at {corners} vehicles, not proved"
    limits = f"Ms ≤ {NOMINAL_PEAK:g}, ≤ {SPREAD_PEAK:g} over the spreads, delay margin ≥ {1e3 * least:.3g} ms"
    return Verdict.SOUND, (f"stable over the spreads, {how}; {limits}",)


def _find_weakness(axis: AxisJudgement, least_delay: float) -> Iterator[str]:
    """Yield what an axis has beyond a threshold."""
    if axis.nominal.Ms > NOMINAL_PEAK:
        yield f"Ms {axis.nominal.Ms:.3g}, above {NOMINAL_PEAK:g}"
    if axis.Ms_found > SPREAD_PEAK:
        yield f"Ms {axis.Ms_found:.3g} over the spreads, above {SPREAD_PEAK:g}"
    elif (axis.Ms_proved or 0.0) > SPREAD_PEAK:
        yield f"Ms above {SPREAD_PEAK:g} over the spreads is not ruled out, {axis.Ms_found:.3g} is found"
    if axis.worst.delay_margin < least_delay:
        late = f"unstable at {1e3 * axis.worst.delay_margin:.3g} ms of further delay"
        yield f"{late}, a sample and {1e3 * SPARE_DELAY:g} ms is {1e3 * least_delay:.3g} ms"
