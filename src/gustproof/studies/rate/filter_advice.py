"""Filters of an autopilot's gyro, weighed: what each lets through of a flight's vibration, and what its phase costs."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.law.form import Law
from gustproof.logs.identify.gyro_spectrum import LOWEST_HZ, GyroSpectrum, VibrationLine
from gustproof.robust.lti.margins import input_margins
from gustproof.types import Array

_CORNERS = (0.7, 1.4, 2.0)  # of the gyro's low-pass
_LOW_PASS = {"px4": "IMU_GYRO_CUTOFF", "ardupilot": "INS_GYRO_FILTER"}
_SWITCH = {"px4": ("IMU_GYRO_NF0_FRQ",), "ardupilot": ("INS_HNTCH_ENABLE", "INS_HNTC2_ENABLE")}
_FOLLOWING = {
    "px4": (("IMU_GYRO_DNF_EN", ""),),
    "ardupilot": (("INS_HNTCH_ENABLE", "INS_HNTCH_MODE"), ("INS_HNTC2_ENABLE", "INS_HNTC2_MODE")),
}  # switch, and mode other than 0, of notches that move
_WIDTH = 0.4  # of a notch, by its frequency
_NOTCHED = 2  # lines that a notch is tried for
_OFF = "all notches off"
_SAME = 1.01  # [-] of Ms
_WORTH = 0.95  # [-] of vibration or delay margin, beyond which filters are no better
QUIET = 0.01
"""[-] share of the command's full scale below which vibration does no harm: motors follow it by a percent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterChoice:
    """Filters, with what they let through and what they cost at the gains that flew."""

    label: str
    """Change in words."""
    changes: Mapping[str, float]
    """New values by name of the parameter [in its own units]; empty for the filters that flew."""
    shaking: tuple[float, ...]
    """(3,) [-] rms of the command that vibration makes, of full scale."""
    Ms: tuple[float, ...]
    """(3,) [-] nominal sensitivity of the axes; empty if a loop is unstable."""
    delay_ms: tuple[float, ...]
    """(3,) [ms] delay margin of the axes; empty likewise."""


def weigh_filters(
    kind: str, parameters: Mapping[str, float], spectrum: GyroSpectrum, vehicle: Vehicle, scenario: Scenario
) -> tuple[FilterChoice, ...]:
    """Return the filters that flew and others at the same gains, each for the same flight's vibration.

    Others are a notch at the strongest lines, another corner of the low-pass, both, and all notches off. What a filter
    takes away is weighed on the raw gyro: a log behind the filters has none to weigh, and the result is empty.

    Raises
    ------
    ConfigError
        If the autopilot's loops can't be built on the vehicle.
    """
    if not spectrum.is_raw:
        return ()
    tried = [("as flown", {}), *_candidates(kind, parameters, spectrum.lines)]
    found = [
        each
        for label, changes in tried
        if (each := _weigh(label, changes, kind, parameters, spectrum, vehicle, scenario)) is not None
    ]
    return tuple(found)


def best_choice(choices: tuple[FilterChoice, ...]) -> FilterChoice | None:
    """Return better filters than those that flew, if there are any.

    Where vibration moves the command by more than 1 % of full scale, they are those that let least through, at no more
    Ms of any axis. Where it does not, filters may be opened: they are those with the longest delay margins.
    """
    if not choices or not choices[0].Ms:
        return None
    flown, *others = choices
    stable = [each for each in others if each.Ms]
    if max(flown.shaking) > QUIET:
        good = [each for each in stable if all(a <= _SAME * b for a, b in zip(each.Ms, flown.Ms, strict=True))]
        best = min(good, key=lambda each: max(each.shaking), default=flown)
        return best if max(best.shaking) < _WORTH * max(flown.shaking) else None
    best = max((each for each in stable if max(each.shaking) <= QUIET), key=_least_delay, default=flown)
    return best if _WORTH * _least_delay(best) > _least_delay(flown) else None


def _least_delay(choice: FilterChoice) -> float:
    return min(choice.delay_ms)


def _candidates(
    kind: str, parameters: Mapping[str, float], lines: tuple[VibrationLine, ...]
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield other filters: in words, and as parameters."""
    low_pass, settings = _LOW_PASS[kind], AUTOPILOTS[kind].settings
    corner = parameters.get(low_pass, settings[low_pass].default)
    corners = [
        (f"low-pass at {value:.0f} Hz", {low_pass: float(round(value))})
        for value in (factor * corner for factor in _CORNERS)
        if settings[low_pass].low <= value <= settings[low_pass].high and value
    ]
    yield from corners
    for label, notched in notch_choices(kind, parameters, lines):
        yield label, notched
        if label != _OFF:
            yield from ((f"{label}, {also}", {**notched, **changes}) for also, changes in corners[1:])


def notch_choices(
    kind: str, parameters: Mapping[str, float], lines: Sequence[VibrationLine]
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield other notches than those of `parameters`: none, and one at each of the strongest lines.

    Notches that follow the rotors' speed or a spectrum are kept: how much they take away is not known here.
    """
    if any(parameters.get(switch, 0.0) and parameters.get(mode, 1.0) for switch, mode in _FOLLOWING[kind]):
        return
    if any(parameters.get(name, 0.0) for name in _SWITCH[kind]):
        yield _OFF, dict.fromkeys(_SWITCH[kind], 0.0)
    yield from ((f"notch at {line.hertz:.0f} Hz", _notch(kind, line.hertz)) for line in lines[:_NOTCHED])


def _notch(kind: str, hertz: float) -> dict[str, float]:
    """Return the parameters of one fixed notch."""
    center, width = float(round(hertz)), float(round(_WIDTH * hertz))
    if kind == "px4":
        return {"IMU_GYRO_NF0_FRQ": center, "IMU_GYRO_NF0_BW": width}
    values = {"ENABLE": 1.0, "MODE": 0.0, "FREQ": center, "BW": width, "ATT": 40.0, "HMNCS": 1.0, "OPTS": 0.0}
    return {f"INS_HNTCH_{key}": value for key, value in values.items()}


def _weigh(
    label: str,
    changes: Mapping[str, float],
    kind: str,
    parameters: Mapping[str, float],
    spectrum: GyroSpectrum,
    vehicle: Vehicle,
    scenario: Scenario,
) -> FilterChoice | None:
    """Return the figures of some filters; `None` if the autopilot takes no such value."""
    try:
        law = autopilot_law(kind, {**parameters, **changes}, vehicle, rate_hz=scenario.control_rate_hz).law
    except ConfigError:
        if not changes:
            raise
        return None
    try:
        loops = input_margins(hover_plant(vehicle, scenario), loop_law(law))
    except ValueError:  # unstable
        loops = ()
    return FilterChoice(
        label=label,
        changes=dict(changes),
        shaking=shaking(law, spectrum, vehicle),
        Ms=tuple(loop.Ms for loop in loops),
        delay_ms=tuple(1e3 * loop.delay_margin for loop in loops),
    )


def shaking(law: Law, spectrum: GyroSpectrum, vehicle: Vehicle) -> tuple[float, ...]:
    """Return the rms [-] of the command about each axis that vibration makes, of full scale."""
    seen = (spectrum.hertz >= LOWEST_HZ) & (spectrum.hertz < 0.5 / law.dt)
    gains = np.abs(loop_law(law).response(2.0 * math.pi * spectrum.hertz[seen]))
    step = spectrum.hertz[1] - spectrum.hertz[0]
    square: Array = np.einsum("fij,jf->i", gains**2, spectrum.density[:, seen]) * step
    return tuple((np.sqrt(square) / np.array(vehicle.torque_limit)).tolist())
