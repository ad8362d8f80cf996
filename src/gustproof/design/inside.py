"""A law inside an autopilot by the model, and the autopilot's own loops: their errors and prices, and equal ones.

Inside, a law runs at the autopilot's rate, behind its gyro filter, and its outputs are rounded. Its price is the torque
slew and the sensitivity peak that it then has. A comparison is fair with own loops that may spend as much.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from firmware_model.config.firmware import LAW_GYRO_FILTER_HZ
from firmware_model.config.gyro_filters import butterworth
from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.vehicle import Vehicle
from firmware_model.external.interface import scenario_for
from firmware_model.external.versions import find_row
from gustproof.airframe.output_rounding import rounding_slew
from gustproof.airframe.predict import predict
from gustproof.design.autopilot_gains import AutopilotTuning, tune_gains
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.design.loops.settings import drop_fractions
from gustproof.design.tune import worst_margins
from gustproof.errors import DesignError
from gustproof.law.form import Law
from gustproof.law.resample import resample

_LEAST_PEAK = 1.4
"""[-] sensitivity peak that own loops may have however small that of the law: below it they lose much."""


class PriceInside(NamedTuple):
    """Error and price of a law inside an autopilot, or of the autopilot's own loops, by the model."""

    seen_rmse: float
    """[rad] rms attitude error by the autopilot's own estimate, pooled over the axes."""
    slew: float
    """[N*m/s] rms torque slew, pooled over the axes, with that of rounded outputs."""
    Ms: float
    """[-] largest sensitivity peak of an axis."""


def behind_filter(law: Law, cutoff: float) -> Law:
    """Return a law that reads its gyro through a low-pass of the second order with a corner `cutoff` [Hz]."""
    b0, b1, b2, a1, a2 = butterworth(cutoff, 1.0 / law.dt)
    n, eye = law.order, np.eye(3)
    A = np.zeros((n + 6, n + 6))
    A[:n, :n], A[:n, n : n + 3] = law.A, law.B[:, :3]
    A[n:, n:] = np.kron([[-a1, 1.0], [-a2, 0.0]], eye)
    B = np.vstack([law.B, np.zeros((6, law.B.shape[1]))])
    B[:n, :3] *= b0
    B[n : n + 3, :3], B[n + 3 :, :3] = (b1 - a1 * b0) * eye, (b2 - a2 * b0) * eye
    C = np.hstack([law.C, law.D[:, :3], np.zeros((3, 3))])
    D = np.hstack([b0 * law.D[:, :3], law.D[:, 3:]])
    G, H = (np.vstack([matrix, np.zeros((6, 3))]) for matrix in (law.G, law.H))
    return replace(law, A=A, B=B, C=C, D=D, G=G, H=H, rate_limit=None)


def price_inside(
    kind: str, law: Law, vehicle: Vehicle, scenario: Scenario, cutoff: float = LAW_GYRO_FILTER_HZ
) -> PriceInside:
    """Return what a torque law spends inside `px4` or `ardupilot` in the scenario's turbulence.

    The gyro's filter has a corner `cutoff` [Hz].

    Raises
    ------
    DesignError
        If it commands rates, has no estimate of attitude, or is unstable behind the gyro filter.
    ValueError
        If the scenario has no turbulence.
    """
    script = scenario_for(kind, scenario)
    flown = behind_filter(resample(law, float(script.control_rate_hz)), cutoff)
    try:
        return _price(kind, flown, vehicle, script)
    except DesignError as error:
        raise DesignError(f"{error}, behind a gyro filter of {cutoff:g} Hz") from None


def price_loops(
    kind: str, parameters: Mapping[str, float], vehicle: Vehicle, scenario: Scenario, version: str = ""
) -> PriceInside:
    """Return what the own loops of `px4` or `ardupilot` spend in the scenario's turbulence.

    What is not among the `parameters` has the default of the version.

    Raises
    ------
    ConfigError
        If a parameter is out of range.
    DesignError
        If the loops are unstable.
    ValueError
        If the scenario has no turbulence.
    """
    script, row = scenario_for(kind, scenario), find_row(kind, version)
    values = {**(row.defaults if row else {}), **drop_fractions(AUTOPILOTS[kind], parameters)}
    law = autopilot_law(kind, values, vehicle, rate_hz=script.control_rate_hz).law
    return _price(kind, law, vehicle, script)


def _price(kind: str, law: Law, vehicle: Vehicle, script: Scenario) -> PriceInside:
    found = predict(law, vehicle, script)
    if found is None or found.seen_rmse is None:
        raise DesignError(f"law '{law.name}' commands no torque, or has no attitude: no loops are at its price")
    rounding = rounding_slew(found.axes_slew, vehicle.rotors, AUTOPILOTS[kind].thrust_step(vehicle), script.dt)
    try:
        Ms = worst_margins(law, vehicle, script).Ms
    except ValueError:
        raise DesignError(f"law '{law.name}' is unstable") from None
    return PriceInside(found.seen_rmse, math.hypot(found.slew, rounding), Ms)


def equal_gains(kind: str, law: Law, vehicles: VehicleSet, scenario: Scenario) -> tuple[PriceInside, AutopilotTuning]:
    """Return what a law spends inside an autopilot, and the best gains of the autopilot's own loops at that price.

    The gains may leave the ranges that the autopilot documents, see `AutopilotTuning.outside_ranges`.

    Raises
    ------
    DesignError
        If no such gains are found, or see `price_inside`.
    ValueError
        If the scenario has no turbulence.
    """
    price = price_inside(kind, law, vehicles.nominal, scenario)
    tuning = tune_gains(
        kind,
        vehicles,
        scenario,
        slew=price.slew,
        sensitivity_peak=max(price.Ms, _LEAST_PEAK),
        in_ranges=False,
    )
    return price, tuning
