"""Level a cascade by the accelerometer: its own attitude of roll and pitch follows gravity slowly.

The gyro's attitude and gravity's are complementary, so the loop, its margins and its torque slew stay those of the
cascade. Only the random walk that the gyro's noise makes of the attitude ends.
"""

import math
from dataclasses import replace

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle
from gustproof.airframe.covariance import axis_models
from gustproof.airframe.predict import predict
from gustproof.law.form import GRAVITY_AIDED_SIZE, Law

_SHARE = 0.25
"""[-] of the Kalman gain that is used. On the stand the error grows by a hundredth. In free flight gusts, whose force
the accelerometer takes for tilt, turn the vehicle by half as much."""


def level_cascade(law: Law, vehicle: Vehicle, scenario: Scenario) -> Law:
    """Return the `law`, a cascade on strapdown attitude, levelled about roll and pitch.

    Its gain is a share of the Kalman filter's, for white noise of the gyro and of the accelerometer. Without noise of
    the accelerometer in the scenario that of the vehicle counts.

    Raises
    ------
    ValueError
        If the scenario has no turbulence.
    """
    walk = (axis_models(vehicle, scenario)[0].noise * scenario.dt) ** 2
    gravity = (vehicle.accelerometer.noise_density / GRAVITY) ** 2 * 0.5 / scenario.dt
    error = 0.5 * walk + math.sqrt(0.25 * walk**2 + walk * gravity)
    gain = _SHARE * error / (error + gravity) if error > 0.0 else 0.0
    new = GRAVITY_AIDED_SIZE - law.D.shape[1]
    follow = gain * np.eye(law.order, new)
    limit = law.rate_limit
    gravity_aided = replace(
        law,
        A=law.A - np.pad(follow, ((0, 0), (0, law.order - new))),
        B=np.hstack([law.B, follow]),
        D=np.pad(law.D, ((0, 0), (0, new))),
        rate_limit=limit and replace(limit, T=np.pad(limit.T, ((0, 0), (0, new)))),
    )
    found = predict(gravity_aided, vehicle, scenario)
    assert found is not None  # a torque law
    parameters = {
        **law.provenance.parameters,
        "levelling_per_s": gain / scenario.dt,
        "foretold_rmse_deg": math.degrees(found.rmse),
        "foretold_slew_nm_per_s": found.slew,
    }
    design = f"{law.provenance.design}, levelled by the accelerometer"
    return replace(gravity_aided, provenance=replace(law.provenance, design=design, parameters=parameters))
