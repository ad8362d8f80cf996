"""Offsets of each NamedTuple in the packed arrays of constants and state, by name."""

from firmware_model.autopilot.attitude_loop import StabilizerParams, StabilizerState
from firmware_model.autopilot.position_loop import PlaceState, PositionParams, PositionState
from firmware_model.numerics.soa import field_offset, offsets
from firmware_model.physics.actuators import ActuatorParams
from firmware_model.physics.aerodynamics import AirParams
from firmware_model.physics.battery import BatteryParams, BatteryState
from firmware_model.physics.ground import GroundParams
from firmware_model.physics.gust_filters import DrydenParams, DrydenState
from firmware_model.physics.mean_wind import MeanWindParams
from firmware_model.physics.rigid_body import Body, BodyParams
from firmware_model.physics.rotors import LossParams
from firmware_model.physics.sensors import AccelerometerParams, GyroParams
from firmware_model.physics.von_karman import KarmanParams, KarmanState

# Constants: the offset of each NamedTuple, then single numbers, then as many RotorParams as there are rotors.
(
    BODY,
    DRYDEN,
    GYRO,
    STABILIZER,
    POSITION,
    LOSS,
    AIR,
    GROUND,
    MEAN_WIND,
    ACTUATORS,
    ACCELEROMETER,
    BATTERY,
    VON_KARMAN,
    _SINGLE,
) = offsets(
    [
        BodyParams,
        DrydenParams,
        GyroParams,
        StabilizerParams,
        PositionParams,
        LossParams,
        AirParams,
        GroundParams,
        MeanWindParams,
        ActuatorParams,
        AccelerometerParams,
        BatteryParams,
        KarmanParams,
    ]
)
FREE, STEPS, GUST_SCALE, WEIGHT, TOTAL_THRUST, ROTOR_COUNT, HOLDS_PLACE, ROTORS = range(_SINGLE, _SINGLE + 8)

# State, in the same form.
X_BODY, X_DRYDEN, X_STABILIZER, X_POSITION, X_VON_KARMAN, X_PLACE, X_LOAD = offsets(
    [Body, DrydenState, StabilizerState, PositionState, KarmanState, PlaceState]
)
X_DIRECT, X_NEXT_CHANGE, X_BATTERY = X_LOAD + 1, X_LOAD + 4, X_LOAD + 5
X_SAG = X_BATTERY + field_offset(BatteryState, "sag")
X_TILT_DEG = X_PLACE + field_offset(PlaceState, "roll")
"""Roll, then pitch, of the set-point that holds the place."""
