"""A scenario or vehicle that is written as TOML is read back equal, whatever it holds."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given
from hypothesis import strategies as st

from firmware_model.config.files import write_toml
from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario, list_scenarios, load_scenario
from firmware_model.config.vehicle import list_vehicles, load_vehicle
from firmware_model.config.waveforms import (
    DRYDEN_CEILING_M,
    Dryden,
    GustCosine,
    GustReplay,
    MomentSine,
    MomentSquare,
    MomentStep,
    VonKarman,
)

finite = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=0.0, exclude_min=True, allow_infinity=False)
day = st.floats(0.0, 86_400.0)
vector = st.tuples(finite, finite, finite)
text = st.text(st.characters(exclude_categories=["Cs"]))
name = st.text(st.characters(exclude_categories=["C", "Z"], exclude_characters="/\\$."), min_size=1, max_size=25)
rate, phase = st.floats(1e-9, 600.0), st.floats(-100.0, 100.0)
gusts = st.one_of(
    st.builds(kind, kind=st.just(word), wind_speed_20ft_mps=positive, airspeed_mps=st.none() | st.floats(1.0, 1e9))
    for kind, word in ((Dryden, "dryden"), (VonKarman, "von_karman"))
)
gust = st.builds(GustCosine, kind=st.just("one_minus_cosine"), amplitude_mps=vector, start_s=day, length_s=positive)
replay = st.builds(
    GustReplay,
    kind=st.just("replay"),
    rows=st.lists(st.tuples(finite, finite, finite, finite), min_size=2, max_size=4, unique_by=lambda row: row[0])
    .map(sorted)
    .map(tuple),
)
moment = st.one_of(
    st.builds(MomentStep, kind=st.just("step"), amplitude_nm=vector, start_s=day),
    *(
        st.builds(kind, kind=st.just(word), amplitude_nm=vector, rate_rad_s=rate, phase_rad=phase)
        for kind, word in ((MomentSine, "sine"), (MomentSquare, "square"))
    ),
)
scenario = st.builds(
    Scenario,
    name=name,
    description=text,
    duration_s=st.floats(0.004, 100.0),
    altitude_m=st.floats(0.0, DRYDEN_CEILING_M, exclude_min=True),
    delay_samples=st.integers(0, 50),
    wind=st.tuples(gusts, gust, replay) | st.lists(gust, max_size=2).map(tuple),
    moment=st.lists(moment, max_size=3).map(tuple),
    gyro=st.builds(GyroFault, bias_rad_s=vector, noise=st.booleans()),
    accelerometer=st.builds(AccelerometerFault, bias_mps2=vector, noise=st.booleans()),
)


@given(scenario=scenario)
def test_a_written_scenario_is_read_back_equal(scenario: Scenario) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "written.toml"
        write_toml(scenario, path)
        assert load_scenario(path) == scenario


def test_a_shipped_scenario_is_read_back_equal_with_its_events_and_requirements(tmp_path: Path) -> None:
    for name in list_scenarios():
        path = tmp_path / f"{name}.toml"
        write_toml(load_scenario(name), path)
        assert load_scenario(path) == load_scenario(name)


def test_a_written_vehicle_is_read_back_equal(tmp_path: Path) -> None:
    for name in list_vehicles():
        vehicle = replace(load_vehicle(name), actuator_lag=0.1 + 0.2)
        write_toml(vehicle, tmp_path / "written.toml")
        assert load_vehicle(tmp_path / "written.toml") == vehicle
