"""Mean wind: steady, with a logarithmic profile over the height above ground."""

from collections.abc import Sequence
from typing import NamedTuple

from firmware_model.config.waveforms import Constant, Shear, Wind
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.elementary import log
from firmware_model.physics.gust_filters import FOOT
from firmware_model.types import Vector

_MIN_HEIGHT = 3.0 * FOOT  # MIL-F-8785C 3.7.3.2: the profile begins at 3 ft


class MeanWindParams(NamedTuple):
    """Sum of the constant winds, and the shear."""

    north: float  # [m/s] N, at all heights, blowing toward
    east: float
    down: float
    shear_north: float  # [m/s] N, at e times the roughness length
    shear_east: float
    shear_down: float
    inverse_roughness: float  # [1/m]


def mean_wind_params(winds: Sequence[Wind]) -> MeanWindParams:
    """Return the mean wind of a scenario's tables, which hold `shear` at most once."""
    constant = [item.velocity_N for item in winds if isinstance(item, Constant)]
    north, east, down = (float(sum(wind[i] for wind in constant)) for i in range(3))
    shear = next((item for item in winds if isinstance(item, Shear)), None)
    if shear is None:
        return MeanWindParams(north, east, down, 0.0, 0.0, 0.0, 1.0)
    scale = 1.0 / float(log(20.0 * FOOT / shear.roughness_m))
    s_north, s_east, s_down = (scale * component for component in shear.velocity_N)
    return MeanWindParams(north, east, down, s_north, s_east, s_down, 1.0 / shear.roughness_m)


@kernel
def mean_wind(params: MeanWindParams, height: float) -> Vector:
    """Return the mean wind [m/s] N, blowing toward, at a height [m] above ground."""
    profile = log(max(height, _MIN_HEIGHT) * params.inverse_roughness)
    return (
        params.north + profile * params.shear_north,
        params.east + profile * params.shear_east,
        params.down + profile * params.shear_down,
    )
