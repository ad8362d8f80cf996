"""Gains of PX4's and ArduPilot's own loops: limits kept, error least, files that are read again."""

import math
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.parameter_files import read_parameters
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.uncertainty import VehicleSet, load_vehicle_set
from firmware_model.config.vehicle import Vehicle
from firmware_model.external.interface import scenario_for
from gustproof.airframe.hover import hover_plant, is_stable_at_hover, loop_law
from gustproof.airframe.predict import predict
from gustproof.design import autopilot_gains
from gustproof.design.autopilot_gains import AutopilotTuning, corner_vehicles, save_tuning, tune_gains
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law, read_autopilot_law
from gustproof.design.tune import default_slew
from gustproof.errors import DesignError
from gustproof.law.form import Law

SCENARIO, VEHICLES = load_scenario("paper-turbulence"), load_vehicle_set("paper")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=AUTOPILOTS)
def tuning(request: pytest.FixtureRequest) -> AutopilotTuning:
    """Return the tuning of an autopilot at a slew of 7 N m/s."""
    return tune_gains(request.param, VEHICLES, SCENARIO, slew=7.0)


def test_limits_are_kept_and_reached(tuning: AutopilotTuning) -> None:
    script = scenario_for(tuning.kind, SCENARIO)
    assert tuning.Ms <= 1.4
    assert tuning.corner_Ms <= 1.5 * 1.4
    assert 0.97 * 7.0 < tuning.slew <= 7.0
    assert max(tuning.Ms / 1.4, tuning.corner_Ms / (1.5 * 1.4)) == pytest.approx(1.0, rel=1e-2)
    found = predict(tuning.law, VEHICLES.nominal, script)
    assert found is not None
    assert (found.rmse, found.seen_rmse) == pytest.approx((tuning.rmse, tuning.seen_rmse))
    for vehicle in corner_vehicles(VEHICLES):
        assert is_stable_at_hover(tuning.law, vehicle, script)


def test_it_beats_gains_tuned_by_hand_at_their_price() -> None:
    shipped = {name: float(value) for name, value in read_parameters("tuned", "px4").items()}
    by_hand = predict(autopilot_law("px4", shipped, VEHICLES.nominal).law, VEHICLES.nominal, SCENARIO)
    assert by_hand is not None
    assert by_hand.seen_rmse is not None
    assert tune_gains("px4", VEHICLES, SCENARIO, slew=by_hand.slew).seen_rmse < 0.85 * by_hand.seen_rmse


def price(law: Law, vehicle: Vehicle, script: Scenario) -> float:
    """Return the largest sensitivity of an axis on a grid, by the definition."""
    omega = np.geomspace(1.0, 0.99 * math.pi / law.dt, 400)
    K, P = loop_law(law).response(omega), hover_plant(vehicle, script).response(omega)
    return max(float(np.abs(1.0 / (1.0 - K[:, i, i] * P[:, i, i])).max()) for i in range(3))


def test_a_gain_changed_for_less_error_breaks_a_limit(tuning: AutopilotTuning) -> None:
    script, vehicle = scenario_for(tuning.kind, SCENARIO), VEHICLES.nominal
    own = predict(tuning.law, vehicle, script)
    assert own is not None
    corners = corner_vehicles(VEHICLES)
    peaks = [price(tuning.law, each, script) for each in (vehicle, *corners)]
    assert (peaks[0], max(peaks[1:])) == pytest.approx((tuning.Ms, tuning.corner_Ms), rel=3e-3)
    better = 0
    for name in [each for each in tuning.parameters if each.endswith(("_P", "_I", "_D"))]:
        for factor in (0.97, 1.03):
            changed = {**tuning.parameters, name: factor * tuning.parameters[name]}
            law = autopilot_law(tuning.kind, changed, vehicle).law
            found = predict(law, vehicle, script)
            assert found is not None
            if found.rmse < own.rmse * (1.0 - 1e-4):
                better += 1
                broken = [price(law, each, script) for each in (vehicle, *corners)]
                assert found.slew > own.slew or broken[0] > 1.395 or max(broken[1:]) > 1.5 * 1.4 * (1.0 - 4e-3)
    assert better


def test_the_same_vehicle_has_the_same_gains_and_the_search_tells_how_far_it_is(tuning: AutopilotTuning) -> None:
    told = list[float]()
    again = tune_gains(tuning.kind, VEHICLES, SCENARIO, slew=7.0, progress=lambda share, _: told.append(share))
    assert again.parameters == tuning.parameters
    assert told == sorted(told)
    assert 0.0 == told[0] <= told[-1] < 1.0


def test_its_file_is_read_as_its_law(tuning: AutopilotTuning, tmp_path: Path) -> None:
    path = tmp_path / "mine.params"
    save_tuning(tuning, VEHICLES.nominal, path)
    written, whole = read_parameters(path, tuning.kind), AUTOPILOTS[tuning.kind].whole
    assert all(float(value).is_integer() for name, value in written.items() if name in whole)
    assert (tuning.kind == "ardupilot") == ("INS_GYRO_FILTER" in written.keys() & whole)
    found = read_autopilot_law(path, VEHICLES.nominal)
    assert (found.law.A == tuning.law.A).all()
    assert (found.law.D == tuning.law.D).all()
    text = path.read_text()
    own = f"({math.degrees(tuning.seen_rmse):.3g} deg by its own attitude, without the walk of the gyro's noise)"
    assert f"predicted: error {math.degrees(tuning.rmse):.3g} deg {own}" in text
    assert all(name.startswith(("MC_", "IMU_", "ATC_", "INS_GYRO_FILTER")) for name in written)
    assert not [name for name in written if name.endswith(("_SMAX", "_IMAX"))]


@pytest.mark.parametrize(("scale", "overall"), [(1.0, 2.1), (0.005, 0.6)], ids=["above", "below"])
def test_gains_beyond_px4_s_ranges_are_told_by_an_overall_gain(scale: float, overall: float) -> None:
    axis = "YAW" if scale == 1.0 else "ROLL"
    own = {f"MC_{axis}RATE_{name}": scale * value for name, value in (("P", 1.2145), ("I", 10.0), ("D", 0.0176))}
    values = {**dict.fromkeys(sum(autopilot_gains._PX4.own, ()), 0.01), **own}
    found = autopilot_gains._split_gains(AUTOPILOTS["px4"], autopilot_gains._PX4, values)
    assert found.pop(f"MC_{axis}RATE_K") == overall
    found = {name: found[name] for name in own}
    assert not [name for name, value in found.items() if AUTOPILOTS["px4"].describe_limit(name, value)]
    one, other = (
        autopilot_law("px4", each, VEHICLES.nominal).law for each in (own, {**found, f"MC_{axis}RATE_K": overall})
    )
    assert np.allclose(one.D, other.D, rtol=1e-12)
    assert np.allclose(one.C, other.C, rtol=1e-12)


@pytest.mark.parametrize(("share", "outside"), [(1.0, []), (0.01, ["ATC_RAT_YAW_P below ArduPilot's limit, 0.1"])])
def test_ranges_that_ardupilot_documents_are_kept_where_limits_allow(
    share: float, outside: list[str], tmp_path: Path
) -> None:
    iris = load_vehicle_set("iris")
    light = VehicleSet(document={**iris.document, "inertia_B": [share * each for each in iris.nominal.inertia_B]})
    tuning = tune_gains("ardupilot", light, SCENARIO, slew=default_slew(light.nominal, SCENARIO))
    save_tuning(tuning, light.nominal, tmp_path / "mine.param")
    assert tuning.outside_ranges()[:1] == outside
    assert all(f"# {each}" in (tmp_path / "mine.param").read_text() for each in tuning.outside_ranges())


NOTCHES = {
    "px4": {"IMU_GYRO_NF0_FRQ": 35.0, "IMU_GYRO_NF0_BW": 20.0},
    "ardupilot": {"INS_HNTCH_ENABLE": 1.0, "INS_HNTCH_FREQ": 35.0, "INS_HNTCH_BW": 20.0},
}


@pytest.mark.parametrize("kind", AUTOPILOTS)
def test_gains_are_made_for_the_notches_that_are_flown(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = autopilot_law(kind, NOTCHES[kind], VEHICLES.nominal).law.provenance.parameters
    start = autopilot_gains._Search._start
    # the start of the search is its result: whatever it is, its figures are those of the loops with the notches
    monkeypatch.setattr(autopilot_gains._Search, "run", lambda search, *_: search._name(np.exp(start(search, 0.5)[0])))
    plain = tune_gains(kind, VEHICLES, SCENARIO, slew=7.0)
    tuned = tune_gains(kind, VEHICLES, SCENARIO, slew=7.0, flown=flown)
    save_tuning(tuned, VEHICLES.nominal, tmp_path / "mine.params")
    over = {
        **flown,
        **{name: float(value) for name, value in read_parameters(str(tmp_path / "mine.params"), kind).items()},
    }
    judged = autopilot_law(kind, {name: over[name] for name in flown}, VEHICLES.nominal).law
    assert (judged.A == tuned.law.A).all()
    assert price(judged, VEHICLES.nominal, scenario_for(kind, SCENARIO)) == pytest.approx(tuned.Ms, rel=3e-3)
    assert tuned.Ms > 1.005 * plain.Ms  # slow loops, as the paper's vehicle is
    assert tuned.parameters == plain.parameters
    switch = next(iter(NOTCHES[kind]))
    assert f"designed with the notches of {switch} as judged" in (tmp_path / "mine.params").read_text()
    assert plain.describe_notches() == "designed without notches"


def test_limits_that_nothing_keeps_are_refused() -> None:
    with pytest.raises(DesignError, match=r"no gains of PX4 found at sensitivity peak 1\.05.* and slew 0\.01 N\*m/s"):
        tune_gains("px4", VEHICLES, SCENARIO, slew=0.01, sensitivity_peak=1.05)


def test_a_vehicle_without_spreads_has_no_corners() -> None:
    certain = VehicleSet(document={**VEHICLES.document, "inertia_B": [0.25, 0.2, 0.1], "actuator_lag": 0.05})
    assert corner_vehicles(certain) == []
    assert len(corner_vehicles(VEHICLES)) == 4
