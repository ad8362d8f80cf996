"""Gains of an autopilot and the filters of its gyro, chosen together for the vibration of a flight."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from gustproof.design.autopilot_gains import AutopilotTuning, tune_gains
from gustproof.design.loops.models import AUTOPILOTS
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.logs.identify.gyro_spectrum import gyro_spectrum
from gustproof.logs.read.flight_log import FlightLog
from gustproof.studies.rate.advice import autopilot_kind
from gustproof.studies.rate.filter_advice import QUIET, notch_choices, shaking

_LOWERED = 0.75
"""[-] of the least corner, the most at the next try to let less vibration through."""
_TRIES = 6
"""Tries for each choice of notches."""
_UNSEEN = "filters: no raw gyro of a log shows the vibration that they let through"
_LOW_PASS = re.compile(r"IMU_D?GYRO_CUTOFF|INS_GYRO_FILTER|ATC_RAT_\w+_FLTD")


def tune_flown(
    flown: Law,
    log: FlightLog | None,
    vehicles: VehicleSet,
    scenario: Scenario,
    *,
    slew: float,
    sensitivity_peak: float,
    progress: Callable[[float, str], None] = lambda _share, _text: None,
) -> tuple[AutopilotTuning, str]:
    """Return the gains of least error from those that are `flown`, and how their filters were chosen, in words.

    The torque slew is at most `slew` [N*m/s], the sensitivity peak of each axis `sensitivity_peak` [-]. Where a log of
    the flight shows the raw gyro, notches are those that flew, none, or one at a strong line. Those that follow the
    rotors stay. With each, gains and low-passes are searched together. Vibration may move the command no more than in
    the flight, or 1 % of full scale: until it does not, all corners are lowered.

    Raises
    ------
    DesignError
        If there are no such gains; see also `gustproof.design.autopilot_gains.tune_gains`.
    """
    kind, now = autopilot_kind(flown), flown.provenance.parameters
    assert kind is not None  # as the caller has them of an autopilot
    search = partial(tune_gains, kind, vehicles, scenario, slew=slew, sensitivity_peak=sensitivity_peak)
    spectrum = None if log is None else gyro_spectrum(log)
    if log is None or spectrum is None or not spectrum.is_raw:
        return search(flown=now, progress=progress), _UNSEEN
    vehicle, name = vehicles.nominal, AUTOPILOTS[kind].name
    refusal = f"no gains of {name} found that let through as little vibration as in the flight"
    allowed = max(QUIET, *shaking(flown, spectrum, vehicle))
    choices = [("notches as flown", {}), *notch_choices(kind, log.parameters, spectrum.lines)]
    found: list[tuple[AutopilotTuning, str]] = []
    for place, (label, changes) in enumerate(choices):
        corner = math.inf
        for again in range(_TRIES):
            progress((place + again / _TRIES) / len(choices), label)
            try:
                tuning = search(flown={**now, **changes}, most_corner=corner)
            except DesignError as error:
                refusal = str(error)
                break
            left = max(shaking(tuning.law, spectrum, vehicle))
            if left <= allowed:
                told = f"vibration moves the command by {100.0 * left:.2g} %, {100.0 * allowed:.2g} % is allowed"
                found.append((replace(tuning, notches=changes), f"filters: {label}; {told}"))
                break
            corner = _LOWERED * _least_corner(tuning)
    if not found:
        raise DesignError(refusal)
    return min(found, key=lambda each: each[0].seen_rmse)


def _least_corner(tuning: AutopilotTuning) -> float:
    """Return the least corner [Hz] of the low-passes that are tuned."""
    return min(value for name, value in tuning.parameters.items() if _LOW_PASS.fullmatch(name))
