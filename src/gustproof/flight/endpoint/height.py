"""Height loop of a controller whose thrust is its own: from LOCAL_POSITION_NED to collective thrust."""

from firmware_model.config.vehicle import GRAVITY

_SPEED_PER_HEIGHT = 1.5  # [1/s]
_ACCELERATION_PER_SPEED = 3.0  # [1/s] slower than the autopilot's height estimate and the link by a factor of 3
_INTEGRAL_RATE = 0.5  # [1/s] of the speed error: hover thrust is known to some 30 %
_SPEED_LIMIT = 1.0  # [m/s] towards the height
_INTEGRAL_LIMIT = 0.4  # [-] of gravity
_THRUST_RANGE = 0.5, 1.5  # [-] of the hover thrust: keeps room for the attitude
_LONGEST_STEP_S = 0.2


class HeightLoop:
    """Proportional loop on height over a PI loop on vertical speed, at the height where it begins.

    Thrust is taken as proportional to the command, with `hover` [-] for the weight; the integral learns the rest.
    """

    def __init__(self, hover: float) -> None:
        self._hover = hover
        self._target: float | None = None
        self._integral = 0.0
        self._before_ms: int | None = None

    def release(self) -> None:
        """Forget the height: another flies. What is known of the hover thrust stays."""
        self._target = self._before_ms = None

    def thrust(self, time_ms: int, down: float, v_down: float) -> float:
        """Return the thrust [-] at a position [m] and speed [m/s] down, both N, at the autopilot's time [ms]."""
        if self._target is None:
            self._target = down
        step_s = 0.0 if self._before_ms is None else min(max(1e-3 * (time_ms - self._before_ms), 0.0), _LONGEST_STEP_S)
        self._before_ms = time_ms
        climb = _clip(_SPEED_PER_HEIGHT * (down - self._target), _SPEED_LIMIT)
        error = climb + v_down
        change = _ACCELERATION_PER_SPEED * _INTEGRAL_RATE * error * step_s / GRAVITY
        self._integral = _clip(self._integral + change, _INTEGRAL_LIMIT)
        share = 1.0 + _ACCELERATION_PER_SPEED * error / GRAVITY + self._integral
        low, high = _THRUST_RANGE
        return min(self._hover * min(max(share, low), high), 1.0)


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
