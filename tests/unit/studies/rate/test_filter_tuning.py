"""Gains and filters chosen together: for the vibration that a log shows, and no more of it than flew."""

from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.parameter_files import read_parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from gustproof.design import autopilot_gains
from gustproof.design.autopilot_gains import AutopilotTuning, save_tuning
from gustproof.design.loops.models import autopilot_law
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.logs.identify.gyro_spectrum import gyro_spectrum
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.studies.rate.filter_advice import QUIET, shaking
from gustproof.studies.rate.filter_tuning import tune_flown
from gustproof.studies.rate.tuning_steps import plan_steps

AIR, IRIS = load_scenario("paper-turbulence"), load_vehicle_set("iris")
LINE_HZ = 62.0
pytestmark = pytest.mark.slow


def shaken(level: float, *, is_raw: bool = True, **parameters: float) -> FlightLog:
    """Return a log of a hover, with a line of `level` [rad/s] at `LINE_HZ` in the gyro."""
    random, time = np.random.default_rng(3), np.arange(8000) / 400.0
    gyro = 0.002 * random.standard_normal((8000, 3)) + level * np.sin(2.0 * np.pi * LINE_HZ * time)[:, None]
    return FlightLog(
        source="hover.ulg",
        system="px4",
        gyro=LogSignal(time=time, values=gyro),
        is_gyro_raw=is_raw,
        airborne=((0.0, 20.0),),
        parameters=parameters,
    )


@pytest.fixture
def unsearched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the start of each search its result: what is tested is the choice of filters."""
    start = autopilot_gains._Search._start
    monkeypatch.setattr(autopilot_gains._Search, "run", lambda search, *_: search._name(np.exp(start(search, 0.5)[0])))


def tuned(log: FlightLog | None) -> tuple[Law, AutopilotTuning, str]:
    """Return the loops that flew, the gains from there, and what is said of filters."""
    flown = autopilot_law("px4", {} if log is None else log.parameters, IRIS.nominal).law
    return flown, *tune_flown(flown, log, IRIS, AIR, slew=4.0, sensitivity_peak=1.4)


def test_a_strong_line_gets_a_notch_and_the_file_holds_what_was_designed_with(tmp_path: Path) -> None:
    log, center = shaken(0.3), "IMU_GYRO_NF0_FRQ"
    flown, tuning, told = tuned(log)
    spectrum = gyro_spectrum(log)
    assert spectrum is not None
    assert tuning.notches[center] == pytest.approx(LINE_HZ, abs=1.0)
    assert told.startswith("filters: notch at 6")
    assert max(shaking(tuning.law, spectrum, IRIS.nominal)) <= max(QUIET, *shaking(flown, spectrum, IRIS.nominal))
    _, first, *_, last = plan_steps(tuning, flown, IRIS, AIR)
    for step in (first, last):
        save_tuning(step.tuning, IRIS.nominal, tmp_path / "mine.params")
        values = {name: float(value) for name, value in read_parameters(tmp_path / "mine.params", "px4").items()}
        assert values[center] == tuning.notches[center]
        again = autopilot_law("px4", {**flown.provenance.parameters, **values}, IRIS.nominal).law
        np.testing.assert_allclose(again.D, step.tuning.law.D, rtol=1e-4)
        np.testing.assert_allclose(again.A, step.tuning.law.A, rtol=1e-3, atol=1e-9)


@pytest.mark.usefixtures("unsearched")
def test_vibration_without_a_notch_lowers_the_corners_and_notches_that_follow_rotors_stay() -> None:
    still, loud = (tuned(shaken(level, IMU_GYRO_DNF_EN=1.0))[1] for level in (0.0, 0.6))
    assert not loud.notches
    assert loud.parameters["IMU_GYRO_CUTOFF"] < still.parameters["IMU_GYRO_CUTOFF"]


@pytest.mark.usefixtures("unsearched")
def test_filters_that_nothing_shows_are_told_so() -> None:
    for log in (None, shaken(0.3, is_raw=False)):
        _, tuning, told = tuned(log)
        assert told == "filters: no raw gyro of a log shows the vibration that they let through"
        assert not tuning.notches


def test_gains_that_nothing_finds_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(autopilot_gains._Search, "run", lambda *_: None)
    with pytest.raises(DesignError, match=r"^no gains of PX4 found at sensitivity peak 1\.4"):
        tuned(shaken(0.1))
