"""What is told of a vehicle that a log shows, whatever the log."""

from types import SimpleNamespace
from typing import Any

import pytest

from firmware_model.errors import ConfigError
from gustproof.logs.identify import shown_vehicle
from gustproof.logs.identify.shown_vehicle import ShownVehicle, show_vehicle

FOUND: Any = SimpleNamespace(
    axes=[SimpleNamespace(advice="fly a chirp"), SimpleNamespace(advice=""), SimpleNamespace(advice="fly a chirp")],
    findings=["gyro: 3 gaps", "roll is not identified", "yaw is not identified"],
)
DOUBTS = ("gyro: 3 gaps", "fly a chirp")


def show(monkeypatch: pytest.MonkeyPatch, *, file: bool = True, air: bool = True) -> ShownVehicle:
    def make_file(_: str, found: Any, known: Any, its_air: Any = None) -> Any:
        if not file:
            raise ConfigError("no vehicle")
        assert (found, known.like) == (FOUND, "iris")
        return SimpleNamespace(findings=("rotors are assumed",), vehicle="mine", air=its_air)

    def estimate(_: object, found: Any, vehicle: object) -> Any:
        assert (found, vehicle) == (FOUND, "mine")
        if not air:
            raise ConfigError("no air")
        return SimpleNamespace(doubt="gusts are quick")

    monkeypatch.setattr(shown_vehicle, "identify", lambda *_, **__: FOUND)
    monkeypatch.setattr(shown_vehicle, "make_vehicle_file", make_file)
    monkeypatch.setattr(shown_vehicle, "estimate_air", estimate)
    monkeypatch.setattr(shown_vehicle, "turbulence_scenario", lambda name, its_air, _: (name, its_air))
    log: Any = None
    return show_vehicle(log, "mine")


def test_a_vehicle_in_air_is_shown_with_its_doubts(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: Any = show(monkeypatch)
    assert shown.findings == (*DOUBTS, "rotors are assumed", "gusts are quick")
    assert (shown.refusal, shown.file.air) == ("", shown.air)
    assert shown.scenario() == ("its-own-air", shown.air)


def test_a_vehicle_without_air_is_shown_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: Any = show(monkeypatch, air=False)
    assert shown.findings == (*DOUBTS, "no air", "rotors are assumed")
    assert (shown.refusal, shown.air, shown.file.air, shown.scenario()) == ("no air", None, None, None)


def test_no_vehicle_is_refused_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = show(monkeypatch, file=False)
    assert shown.findings == (*DOUBTS, "no vehicle")
    assert (shown.file, shown.air, shown.scenario()) == (None, None, None)
    with pytest.raises(ConfigError, match="no vehicle"):
        shown.vehicles()
