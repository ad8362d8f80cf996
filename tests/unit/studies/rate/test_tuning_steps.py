"""Steps from flown gains to a tuning: what each may change, and what is loaded is what was promised."""

import itertools
import math
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from firmware_model.config.parameter_files import GROUND_STATION_FORMS, write_parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.errors import ConfigError
from gustproof.cli.app import app
from gustproof.cli.laws import read_gains
from gustproof.cli.tune import _Flown, _tune_autopilot
from gustproof.design.autopilot_gains import save_tuning, tune_gains
from gustproof.design.loops.models import autopilot_law
from gustproof.errors import DesignError
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.robust.lti.margins import LoopMargins
from gustproof.show.report.gain_steps import render_steps
from gustproof.studies.rate import tuning_steps
from gustproof.studies.rate.judge import MOST_SLEW
from gustproof.studies.rate.tuning_steps import (
    MOST_GAIN,
    TuningStep,
    _go,
    describe_choice,
    describe_filters,
    first_flyable,
    is_sound,
    plan_steps,
)

AIR, IRIS = load_scenario("paper-turbulence"), load_vehicle_set("iris")
FLOWN = {
    "px4": {
        "MC_ROLLRATE_P": 0.1,
        "MC_ROLLRATE_I": 0.05,
        "MC_YAWRATE_K": 1.5,
        "IMU_GYRO_NF0_FRQ": 60.0,
        "MC_YAW_TQ_CUTOFF": 10.0,
    },
    "ardupilot": {"ATC_RAT_RLL_P": 0.05, "INS_GYRO_FILTER": 20.0, "SCHED_LOOP_RATE": 800.0, "FRAME_CLASS": 1.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FLOWN)
def test_no_step_changes_more_than_a_pilot_can_feel_and_each_loads_as_promised(kind: str, tmp_path: Path) -> None:
    flown = autopilot_law(kind, FLOWN[kind], IRIS.nominal).law
    goal = tune_gains(kind, IRIS, AIR, slew=4.0, flown=flown.provenance.parameters)
    now, *steps = plan_steps(goal, flown, IRIS, AIR)
    assert (now.tuning.law.A == flown.A).all()
    end = steps[-1].tuning.parameters
    assert end == pytest.approx({name: goal.parameters[name] for name in end}, rel=1e-4)
    assert len(steps) > 2
    for before, after in zip([now, *steps], steps, strict=False):
        assert after.tuning.slew < 1.02 * MOST_SLEW * before.tuning.slew
        old, new = before.tuning.parameters, after.tuning.parameters
        for name in end:
            if now.tuning.parameters[name] and new[name]:
                whole = [each[name] * each.get(f"{name[:-1]}K", 1.0) for each in (old, new)]
                limit = MOST_GAIN * (1.0 + (0.5 / new[name] if name == "INS_GYRO_FILTER" else 1e-3))
                assert name.endswith("_K") or 1.0 / limit < whole[1] / whole[0] < limit, name
    low_pass = {"px4": "MC_YAW_TQ_CUTOFF", "ardupilot": "ATC_RAT_YAW_FLTE"}[kind]
    corners = [each.tuning.parameters[low_pass] for each in (now, *steps)]
    assert corners[-1] == 0.0
    assert all(1.0 < new / old < 1.001 * MOST_GAIN for old, new in itertools.pairwise(corners[:-1]))
    assert corners[-2] * MOST_GAIN > 0.24 / flown.dt  # next to off
    (told,) = describe_filters([now, *steps], 1)
    assert told.startswith(f"{low_pass}: {corners[0]:.3g} Hz to {corners[1]:.3g} Hz, where its lag costs yaw ")
    save_tuning(steps[0].tuning, IRIS.nominal, tmp_path / "step.params")
    mine = tmp_path / "mine.params"
    write_parameters({name: f"{value:g}" for name, value in FLOWN[kind].items()}, mine, GROUND_STATION_FORMS[kind])
    loaded, _, _ = read_gains(str(tmp_path / "step.params"), IRIS.nominal, over=str(mine))
    np.testing.assert_allclose(loaded.D, steps[0].tuning.law.D, rtol=1e-4)
    assert loaded.dt == steps[0].tuning.law.dt


@pytest.mark.slow
def test_gains_that_are_unstable_now_are_told_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No step is written that is unstable or fragile, and none that raises what another gain makes so."""
    flown = autopilot_law("px4", {"MC_ROLLRATE_P": 3.0}, IRIS.nominal).law
    goal, old = tune_gains("px4", IRIS, AIR, slew=4.0), flown.provenance.parameters
    planned: list[list[TuningStep]] = []
    monkeypatch.setattr(tuning_steps, "_go", lambda *given: planned.append(_go(*given)) or planned[-1])
    now, first, *others = plan_steps(goal, flown, IRIS, AIR)
    even = planned[0]
    assert now.margins is None
    assert math.isinf(now.tuning.Ms)
    assert is_sound(first)
    assert first.tuning.parameters["MC_ROLLRATE_P"] < 0.5
    for name, value in first.tuning.parameters.items():
        assert value <= 1.05 * MOST_GAIN * old[name] or old[name] == 0.0, name  # .05 is of an overall gain K
    assert others[-1].tuning.Ms <= 1.4
    assert first_flyable([now, first, *others]) == 1
    assert [line[:30] for line in describe_choice([now, first], 1)] == ["step 1 divides a gain by 7.7: "]
    # Even steps to where they are sound multiply all gains: each of them is worse.
    at = first_flyable(even)
    assert at > next(place for place, step in enumerate(even) if step.margins is not None) > 2
    assert [is_sound(step) for step in even[1 : at + 1]] == [False] * (at - 1) + [True]
    assert even[at].tuning.Ms <= 2.0 < even[at - 1].tuning.Ms or even[at - 1].tuning.corner_Ms > 2.5
    assert first_flyable(even[at - 2 : at + 1]) == 1, "safer than gains that are stable"
    assert first_flyable(even[:at]) == at - 1, "none is sound: the last"
    assert describe_choice(even[at - 1 : at + 1], 1) == []
    assert "it is safer than what flies, and `judge` calls none sound" in describe_choice(even[at - 2 : at], 1)[0]
    assert "and step 2 is the first that `judge` calls sound" in describe_choice(even[at - 2 : at + 1], 1)[0]
    assert "it is the last, and `judge` calls none sound" in describe_choice(even[at - 2 : at][::-1], 1)[0]
    with pytest.raises(DesignError, match="none of the steps is stable"):
        first_flyable([now, now])
    mine = tmp_path / "mine.params"
    write_parameters({"MC_ROLLRATE_P": "3"}, mine, GROUND_STATION_FORMS["px4"])
    monkeypatch.setattr("gustproof.studies.rate.filter_tuning.tune_gains", lambda *_, **__: goal)
    words = ["tune", "iris", "--from", str(mine), "-o", str(tmp_path / "new.params")]
    result = CliRunner().invoke(app, words)
    told = " ".join(result.output.split())
    assert "px4: the gains that flew are unstable by the model" in told
    assert f"new.params: step 1 of {1 + len(others)}" in "".join(result.output.splitlines())


def test_gains_of_angles_wait_where_a_step_would_have_a_larger_peak_than_both_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def made(values: dict[str, float]) -> Any:
        angle, rate = math.log(values["MC_ROLL_P"], 4.0), math.log(values["MC_ROLLRATE_P"] / 0.1, 4.0)
        peak = 1.3 + 0.1 * angle + angle * (1.0 - rate)
        return SimpleNamespace(kind="px4", parameters=values, Ms=peak, slew=1.0, law=SimpleNamespace(dt=0.004))

    monkeypatch.setattr(
        tuning_steps, "_try", lambda _tuning, _now, values, *_: TuningStep(tuning=made(values), margins=None)
    )
    old = {"MC_ROLL_P": 1.0, "MC_ROLLRATE_P": 0.1}
    goal = made({"MC_ROLL_P": 4.0, "MC_ROLLRATE_P": 0.4})
    steps = _go(goal, TuningStep(tuning=made(old), margins=None), old, IRIS, AIR)
    assert max(step.tuning.Ms for step in steps) <= 1.4 + 1e-9  # 1.6 on the even way
    assert [step.tuning.parameters["MC_ROLL_P"] for step in steps[:3]] == [1.0, 1.0, 1.0]
    assert steps[-1].tuning.parameters == goal.parameters
    assert len(steps) == 7


def test_the_title_names_what_the_written_step_costs() -> None:
    def made(peak: float, slew: float, gain: float, delay: float) -> TuningStep:
        sizes = {"crossover": 1.0, "phase_margin": 1.0, "gain_margin": gain, "gain_reduction_margin": 0.0}
        margins = LoopMargins(**sizes, delay_margin=delay, Ms=peak)
        figures = SimpleNamespace(parameters={}, notches={}, rmse=0.1, slew=slew, Ms=peak, corner_Ms=peak)
        return TuningStep(tuning=figures, margins=margins)  # type: ignore[arg-type]

    def title(steps: list[TuningStep]) -> str:
        console = Console(width=200, file=StringIO(), record=True)
        console.print(render_steps(steps, 1))
        return " ".join(console.export_text().split("┏")[0].split())

    now, dearer = made(1.31, 0.4, 4.5, 0.03), made(1.66, 0.4, 2.8, 0.04)
    assert title([now, dearer]) == "Steps; step 1 costs Ms 1.31 to 1.66, gain up 4.5 to 2.8"
    assert title([now, made(1.31, 0.5, 4.5, 0.02)]) == "Steps; step 1 costs slew 0.4 to 0.5, delay 30 to 20 ms"
    assert title([dearer, made(1.3, 0.4, 4.5, 0.05)]) == "Steps; step 1 costs no margin"


def test_no_step_is_written_on_a_model_that_the_flight_refutes(monkeypatch: pytest.MonkeyPatch) -> None:
    calm = LogSignal(time=0.1 * np.arange(300), values=np.zeros((300, 3)))
    log = FlightLog(source="x.ulg", system="px4", gyro=calm, command=calm, airborne=((0.0, 20.0),))
    lost = TuningStep(tuning=None, margins=None)  # type: ignore[arg-type]
    monkeypatch.setattr("gustproof.studies.rate.filter_tuning.tune_flown", lambda *_, **__: (None, ""))
    monkeypatch.setattr(tuning_steps, "plan_steps", lambda *_: [lost])
    flown = autopilot_law("px4", {}, IRIS.nominal).law
    with pytest.raises(ConfigError, match="the gains that flew are unstable by the model, yet they flew 20 s"):
        _tune_autopilot(_Flown("px4", flown, log), IRIS, AIR, 4.0, 1.4, None, at_once=True, as_json=True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tune", "iris", "--from", "flagship"], "holds no parameters of PX4 or ArduPilot"),
        (["tune", "iris", "--at-once"], "without --from there are no steps; --at-once cannot be given with it"),
        (["tune", "iris", "--from", "no.params"], "no.params"),
        (["tune", "iris", "--from", "px4", "--law", "pid"], "--from tunes the autopilot's own loops"),
    ],
)
def test_a_start_that_is_none_is_refused_in_a_line(arguments: list[str], said: str) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert said in result.output
    with pytest.raises(ConfigError, match="is loaded over parameters of its own autopilot"):
        read_gains("px4", IRIS.nominal, over="ardupilot")
