"""Steps from the gains that an autopilot flies to those of a tuning: none more than a pilot can feel and take back."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from firmware_model.config.firmware import guessed_axes
from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.types import AXES, Vector
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.airframe.predict import predict
from gustproof.design.autopilot_gains import AutopilotTuning
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.logs.read.flight_log import FlightLog
from gustproof.robust.lti.margins import LoopMargins, input_margins, input_peaks, worst_loop
from gustproof.studies.rate.failure_case import spectral_radius
from gustproof.studies.rate.flight_error import flight_errors
from gustproof.studies.rate.judge import MOST_SLEW, NOMINAL_PEAK, SPREAD_PEAK, scenario_for, whole_slew
from gustproof.studies.rate.plant_box import plant_box

_LOW_PASS = re.compile(r"\w+(_CUTOFF|_FLT[TED]|_GYRO_FILTER)")
_IN_LOOP = re.compile(r"MC_(YAW)_TQ_CUTOFF|ATC_RAT_(RLL|PIT|YAW)_FLTE")
"""Filters of the first order that the whole torque of an axis passes."""
_OUTER = re.compile(r"MC_(ROLL|PITCH|YAW)_P|ATC_ANG_[A-Z]+_P|\w+_I")
"""Gains of angles, and integrals: those that lean on the loops of rates."""
_OPEN = 0.25
"""[-] of the loops' rate: a low-pass of such a corner is next to one that is off."""
_SAME_PEAK = 1.005
"""[-] ratio of two Ms that are the same."""
MOST_GAIN = 1.5
"""[-] most by which a step multiplies or divides a gain or a corner."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TuningStep:
    """Gains on the way, and what they are predicted to do."""

    tuning: AutopilotTuning
    """Parameters with error, slew and Ms; infinite if a vehicle of the spreads is unstable."""
    margins: LoopMargins | None
    """Worst margins of the axes with the nominal vehicle; `None` as before."""
    flight_rmse: Vector | None = None
    """[rad] error of roll, pitch and yaw in the logged flight, measured or with these gains; `None` if not told."""
    crossovers: Vector | None = None
    """[rad/s] of roll, pitch and yaw with the nominal vehicle; `None` if unstable."""


def plan_steps(
    tuning: AutopilotTuning, flown: Law, vehicles: VehicleSet, scenario: Scenario, log: FlightLog | None = None
) -> list[TuningStep]:
    """Return the gains that are `flown`, as step 0, and those of each step to a tuning.

    Steps are even in the logarithm of each gain and corner, and a gain that is 0 grows linearly. None multiplies one by
    more than `MOST_GAIN`, or the slew by more than about `MOST_SLEW`. A low-pass that is to be off opens as slowly, and
    is off at the end. Where a step would have a larger Ms than what flies and than the tuning, gains of angles and
    integrals do not rise in it. The notches of the tuning are as there from step 1 on. Where the first that may be
    flown is a later one, step 1 lowers gains as far as that, or one behind it. If that may be flown, the others follow
    from there.
    """
    now = dict(flown.provenance.parameters)
    steps = _go(tuning, _assess(tuning, flown, now, vehicles, scenario), now, vehicles, scenario)
    at = _find_flyable(steps)
    for far in steps[at:] if at is not None and at > 1 else []:
        near, low = steps[1].tuning.parameters, far.tuning.parameters
        values = {name: min(near[name], value) if value > now[name] else value for name, value in low.items()}
        careful = _try(tuning, now, values, flown.dt, vehicles, scenario)
        if _find_flyable([steps[0], careful]):
            steps = [steps[0], *_go(tuning, careful, {**now, **tuning.notches, **values}, vehicles, scenario)]
            break
    return steps if log is None else _in_flight(steps, log, vehicles, scenario)


def _go(
    tuning: AutopilotTuning, start: TuningStep, now: Mapping[str, float], vehicles: VehicleSet, scenario: Scenario
) -> list[TuningStep]:
    """Return the step at which the parameters are `now`, and those from there to the tuning."""
    goal = {name: value for name, value in tuning.parameters.items() if name in now}
    moved, ratios = _ways(now, goal, start.tuning.law.dt)
    count = max(1, *(math.ceil(math.log(each, MOST_GAIN) - 1e-9) for each in ratios), _slew_steps(start, tuning))
    outer = {name for name, (old, new) in moved.items() if new > old and _OUTER.fullmatch(name)}
    most = max(start.tuning.Ms, tuning.Ms) if math.isfinite(start.tuning.Ms) else math.inf

    def step_at(gone: Mapping[str, int]) -> TuningStep:
        """Return the step at which each parameter has gone some of the shares of its way."""
        ways = {name: _between(name, *ends, gone[name] / count, tuning) for name, ends in moved.items()}
        values = {**goal, **{name: value for name, value in ways.items() if gone[name] < count or goal[name]}}
        return _try(tuning, now, values, start.tuning.law.dt, vehicles, scenario)

    return [start, *_walk(step_at, dict.fromkeys(goal, 0), count, outer, _SAME_PEAK * most)]


def _walk(
    step_at: Callable[[Mapping[str, int]], TuningStep], gone: dict[str, int], count: int, outer: set[str], most: float
) -> Iterator[TuningStep]:
    """Yield steps until each parameter has gone `count` shares; those of `outer` wait where Ms is above `most`."""
    while min(gone.values()) < count:
        ahead = {name: min(count, share + 1) for name, share in gone.items()}
        step = step_at(ahead)
        if step.tuning.Ms > most and any(gone[name] < count for name in gone.keys() - outer):
            waiting = {name: gone[name] if name in outer else share for name, share in ahead.items()}
            careful = step_at(waiting)
            if careful.tuning.Ms < step.tuning.Ms:
                step, ahead = careful, waiting
        yield step
        gone = ahead


def _try(
    tuning: AutopilotTuning,
    now: Mapping[str, float],
    values: Mapping[str, float],
    dt: float,
    vehicles: VehicleSet,
    scenario: Scenario,
) -> TuningStep:
    """Return the step to `values` of the tuning's parameters; the others, but for its notches, stay as `now`."""
    loaded = {**now, **tuning.notches, **values}
    law = autopilot_law(tuning.kind, loaded, vehicles.nominal, rate_hz=round(1.0 / dt)).law
    return _assess(tuning, law, values, vehicles, scenario)


def first_flyable(steps: list[TuningStep]) -> int:
    """Return the place of the first step that a pilot may fly.

    It is stable with each vehicle of the spreads. It has the sensitivity peaks that `judge` asks for, or lower ones
    than the gains that fly, where those are stable by the model. If there is none, it is the last step.

    Raises
    ------
    DesignError
        If that is not stable.
    """
    if (at := _find_flyable(steps)) is not None:
        return at
    if steps[-1].margins is None:
        raise DesignError("none of the steps is stable with each vehicle of the spreads")
    return len(steps) - 1


def _find_flyable(steps: list[TuningStep]) -> int | None:
    """Return the place of the first step that is sound, or safer than what flies; `None` if there is none."""
    now = steps[0]
    may = (is_sound(step) or (now.margins is not None and _is_safer(step, now)) for step in steps[1:])
    return next((at for at, flyable in enumerate(may, start=1) if flyable), None)


def describe_choice(steps: list[TuningStep], at: int) -> list[str]:
    """Return remarks on the step that is written, unless it is the first, sound, and no more than a step."""
    sound = next((number for number, step in enumerate(steps) if number and is_sound(step)), None)
    lowered = _describe_fall(steps[0], steps[at], at)
    if at == sound == 1:
        return lowered
    if at == sound:
        return [f"step {at} is written: it is the first that `judge` calls sound by its sensitivity peaks"]
    others = f"step {sound} is the first that `judge` calls sound" if sound else "`judge` calls none sound"
    why = "safer than what flies" if _is_safer(steps[at], steps[0]) else "the last"
    return [f"step {at} is written: it is {why}, and {others} by its sensitivity peaks", *lowered]


def _describe_fall(now: TuningStep, step: TuningStep, at: int) -> list[str]:
    """Return the remark on a step that lowers a gain by more than `MOST_GAIN`."""
    old, new = now.tuning.parameters, step.tuning.parameters
    kept = [name for name in new if not name.endswith("_K") and new[name] > 0.0 and old.get(name, 0.0) > 0.0]
    most = max((_whole_gain(old, name) / _whole_gain(new, name) for name in kept), default=1.0)
    return [f"step {at} divides a gain by {most:.2g}: less is neither sound nor safer"] * (most > 1.01 * MOST_GAIN)


def is_sound(step: TuningStep) -> bool:
    """Return whether a step has the sensitivity peaks that `judge` asks for."""
    return step.margins is not None and step.tuning.Ms <= NOMINAL_PEAK and step.tuning.corner_Ms <= SPREAD_PEAK


def _is_safer(step: TuningStep, now: TuningStep) -> bool:
    one, other = step.tuning, now.tuning
    return one.Ms <= other.Ms and one.corner_Ms <= other.corner_Ms


def _in_flight(steps: list[TuningStep], log: FlightLog, vehicles: VehicleSet, scenario: Scenario) -> list[TuningStep]:
    """Return the steps with their error in the flight of a log, if the gains that flew it are stable by the model."""
    stable = [step for step in steps if step.margins is not None]
    if steps[0].margins is None:
        return steps
    flown, vehicle = steps[0].tuning.law, vehicles.nominal
    laws = [step.tuning.law for step in stable]
    errors = flight_errors(log, flown, laws, vehicle, scenario_for(flown, vehicle, scenario))
    found = dict(zip(map(id, stable), errors, strict=False))
    return [replace(step, flight_rmse=found.get(id(step))) for step in steps]


def describe_filters(steps: list[TuningStep], at: int) -> list[str]:
    """Return a remark on each low-pass of a whole axis that the step `at` changes: its corner, and what it costs."""
    now, step = steps[0], steps[at]
    found = []
    for name, new in step.tuning.parameters.items():
        match, old = _IN_LOOP.fullmatch(name), now.tuning.parameters.get(name, new)
        if match is None or old == new or step.crossovers is None:
            continue
        axis = ("RLL", "PIT", "YAW").index(match[1] or match[2])
        omega = step.crossovers[axis]
        costs = [math.degrees(math.atan(omega / (2.0 * math.pi * each))) if each else 0.0 for each in (old, new)]
        words = [f"{each:.3g} Hz" if each else "off" for each in (old, new)]
        found.append(
            f"{name}: {words[0]} to {words[1]}, where its lag costs {AXES[axis]} {costs[1]:.2g} deg at its crossover, "
            f"{omega:.3g} rad/s, and {costs[0]:.2g} before; motors that twitch want it back"
        )
    return found


def _ways(
    now: Mapping[str, float], goal: Mapping[str, float], dt: float
) -> tuple[dict[str, tuple[float, float]], list[float]]:
    """Return the ends of each parameter that moves, and the ratios of those that must not move by more at once."""
    ends = {name: _ends(name, now[name], value, dt) for name, value in goal.items()}
    moved, ratios = {name: each for name, each in ends.items() if max(each) > 0.0}, list[float]()
    for name, each in moved.items():
        is_filter = _LOW_PASS.fullmatch(name) is not None
        whole = _whole_gain(now, name), _whole_gain(goal, name)
        for old, new in [each] if is_filter else [each, whole]:
            if min(old, new) > 0.0:
                ratios.append(max(new / old, old / new))
    return moved, ratios


def _ends(name: str, old: float, new: float, dt: float) -> tuple[float, float]:
    """Return the ends of a parameter's way: of a low-pass that is off a corner that is next to that."""
    if not _LOW_PASS.fullmatch(name) or old == new:
        return old, new
    return old or max(_OPEN / dt, new), new or max(_OPEN / dt, old)


def _whole_gain(values: Mapping[str, float], name: str) -> float:
    """Return a gain times the overall gain K of its loop, if that has one."""
    return values[name] * values.get(f"{name[:-1]}K", 1.0)


def _slew_steps(start: TuningStep, tuning: AutopilotTuning) -> int:
    old = start.tuning.slew
    ratio = tuning.slew / old if math.isfinite(old) and old > 0.0 else 1.0
    return math.ceil(math.log(ratio, MOST_SLEW) - 1e-9) if ratio > 1.0 else 1


def _between(name: str, old: float, new: float, share: float, tuning: AutopilotTuning) -> float:
    """Return a parameter on the way, a whole number where the autopilot keeps those."""
    value = (1.0 - share) * old + share * new if 0.0 in (old, new) else old ** (1.0 - share) * new**share
    return float(round(value)) if name in AUTOPILOTS[tuning.kind].whole else float(f"{value:.5g}")


def _assess(
    tuning: AutopilotTuning, law: Law, parameters: Mapping[str, float], vehicles: VehicleSet, scenario: Scenario
) -> TuningStep:
    """Return the step of a law, with what `tuning` says of its autopilot."""
    vehicle, script = vehicles.nominal, scenario_for(law, vehicles.nominal, scenario)
    corners = list(plant_box(vehicles).corners())
    own = replace(tuning, parameters=dict(parameters), law=law)
    if any(spectral_radius(law, each, script) >= 1.0 for each in [vehicle, *corners]):
        lost = math.inf
        own = replace(own, rmse=lost, seen_rmse=lost, slew=lost, Ms=lost, corner_Ms=lost)
        return TuningStep(tuning=own, margins=None)
    found, K = predict(law, vehicle, script), loop_law(law)
    assert found is not None  # as for a law of torque
    assert found.seen_rmse is not None  # on strapdown
    held = guessed_axes(vehicle)  # their gains stay, and their margins are a guess
    free = [k for k in range(3) if k not in held]
    loops = input_margins(hover_plant(vehicle, script), K)
    nominal = worst_loop([loops[k] for k in free])
    slew = whole_slew(found, vehicle, AUTOPILOTS[tuning.kind].thrust_step(vehicle), script)
    peaks = [input_peaks(hover_plant(each, script), K) for each in corners]
    corner = max(nominal.Ms, *(each[k] for each in peaks for k in free))
    measured = replace(own, rmse=found.rmse, seen_rmse=found.seen_rmse, slew=slew, Ms=nominal.Ms, corner_Ms=corner)
    roll, pitch, yaw = (loop.crossover for loop in loops)
    return TuningStep(tuning=measured, margins=nominal, crossovers=(roll, pitch, yaw))
