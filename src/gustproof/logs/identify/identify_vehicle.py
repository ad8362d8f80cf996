"""Identification of a vehicle from a flight log: gains, actuator lag, delay, damping, disturbance and gyro noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from firmware_model.errors import ConfigError
from gustproof.logs.identify.bootstrap import bootstrap, interval, widen
from gustproof.logs.identify.curves import Curves, disturbance_corner, disturbance_rms, make_curves, model_response
from gustproof.logs.identify.identification import AxisEstimate, Identification, Interval
from gustproof.logs.identify.likelihood import (
    DAMPING,
    DELAY,
    GAINS,
    HIGHEST_DAMPING,
    LAG,
    NOISE,
    SHARED,
    AxisData,
    maximise,
    places,
    solve_gains,
)
from gustproof.logs.identify.rates import describe_slow_log
from gustproof.logs.identify.stretches import (
    BIN,
    SHORTEST,
    Stretch,
    cut_stretch,
    find_stretches,
    keep_first,
    keep_rest,
    limit_time,
    sample_time,
)
from gustproof.logs.read.flight_log import CommandUnit, FlightLog, LogSignal
from gustproof.types import Array

_AXES = ("roll", "pitch", "yaw")
_ENOUGH, _BRIEF = 150.0, 20.0  # [s] of a long log that are used, and for the first search
_LEARNT = 2.0 / 3.0  # of the flight; the rest is predicted
_LAGS, _DELAYS = (0.015, 0.04, 0.1), (0.002, 0.02)  # [s] where the search starts
_LOOSE = 0.3  # [-] relative half-width above which a gain is not reported
_VAGUE, _EXPLAINED = 0.1, 0.1  # the same, where the command explains less than this share of the accelerations
_WHITE = 1e-3  # of the prediction errors' mean square; white noise below it means that a filter took it away
_MOSTLY = 0.5  # of the accelerations explained, and yet a loose gain: not all of it is flight
_FILTERED = "gyro: filtered before it is logged"
_APART_S = (0.008, 0.012)  # between gyro samples behind a filter: their noise is nearly white again
_FLOOR = 0.01  # of a gain: what the model leaves out, such as gyroscopic moments
_BLUR = 0.2  # of half a sample of the command: noise above its Nyquist frequency folds down and looks like lag
_APART = 6.0  # loss of log likelihood by one lag and delay for all axes: beyond it (p = .002) yaw has its own

Spans = Sequence[tuple[float, float]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Axis:
    """Fitted model of one axis."""

    data: AxisData
    """Measurements."""
    theta: Array
    """(p,) parameters, see `likelihood`."""
    replicates: Array
    """(r, p) the same, bootstrapped."""

    unexplained: float
    """[rad^2/s^2] mean square of the prediction errors."""
    curves: Curves
    """Series."""

    @property
    def wide_gain(self) -> Interval:
        """[rad/s^2 per unit] sum of the channels' magnitudes, however uncertain."""
        gain = interval(self.theta, self.replicates, lambda p: np.abs(p[..., GAINS:-1]).sum(axis=-1))
        return widen(gain, _FLOOR * gain.nominal)

    @property
    def gain(self) -> Interval | None:
        """[rad/s^2 per unit] the same; `None` if the flight does not show it."""
        low, gain, high = self.wide_gain
        explained = self.curves.r_squared(self.curves.corner())
        loose = _LOOSE if explained > _EXPLAINED else _VAGUE
        sound = gain > 0.0 and explained > 0.0 and self.theta[DAMPING] < HIGHEST_DAMPING
        sound = sound and (self.data.square or self.theta[GAINS] > 0.0)
        return self.wide_gain if sound and max(high - gain, gain - low) < loose * gain else None


def identify(log: FlightLog, *, progress: Callable[[float], None] | None = None) -> Identification:
    """Return the estimates of a vehicle from one log.

    `progress` is called with the share of the work that is done, 0..1. The same log gives the same bits. A log does not
    say if its command is held between samples or a sample of something faster. So the delay's interval spans half of a
    sample more. The noise of a gyro that was filtered or averaged before it was logged is not white. That spoils lag
    and delay, so fewer samples are used then, further apart.

    Raises
    ------
    ConfigError
        If the log has no commands, or is too short in the air.
    """
    tell = progress or (lambda _: None)
    command, square = _find_command(log)
    spans = limit_time(find_stretches(log, command), command, _ENOUGH)
    learnt = keep_first(spans, _LEARNT)
    rest = keep_rest(spans, _LEARNT)
    if not learnt or not rest:
        short = f"too short: {3.0 * SHORTEST:g} s in the air without a gap are needed"
        raise ConfigError(f"{log.source}: {describe_slow_log(log, command) or short}")
    tell(0.02)
    dt = max(BIN, sample_time(log.gyro))
    near = _search(_axis_data(_cut(log, command, limit_time(learnt, command, _BRIEF)), square))
    tell(0.3)
    trained = _fit_axes(_axis_data(_cut(log, command, learnt), square), dt, near)
    if (further := _next_spacing(trained, log.gyro)) is not None:
        return identify(_thin(log, further), progress=progress)
    tell(0.6)
    axes = _fit_axes(_axis_data(_cut(log, command, spans), square), dt, [axis.theta for axis in trained])
    tell(0.9)
    ahead = _cut(log, command, rest)
    held_out = [_score_held_out(axis, ahead) for axis in trained]
    return _collect(log, command, axes, held_out)


def _next_spacing(axes: list[_Axis], gyro: LogSignal) -> float | None:
    """Return the next spacing [s] of gyro samples if their noise is coloured; `None` if it is not, or at the last."""
    spacing = 1.2 * sample_time(gyro)
    return next((each for each in _APART_S if each > spacing), None) if _find_coloured_axes(axes) else None


def _thin(log: FlightLog, spacing: float) -> FlightLog:
    """Return the log with a gyro sample in each `spacing` [s]."""
    step = round(spacing / sample_time(log.gyro))
    gyro = LogSignal(time=log.gyro.time[::step], values=log.gyro.values[::step])
    told = [line for line in log.findings if not line.startswith(_FILTERED)]
    return replace(log, gyro=gyro, findings=(*told, f"{_FILTERED}: one sample in {1e3 * spacing:g} ms is used"))


def _find_coloured_axes(axes: list[_Axis]) -> list[str]:
    """Return the axes of the gyro whose noise is not white."""
    return [_AXES[axis.data.axis] for axis in axes if np.exp(axis.theta[NOISE]) < _WHITE * axis.unexplained]


def _find_command(log: FlightLog) -> tuple[LogSignal, bool]:
    """Return the commands to explain the rates by, and whether they are of motors."""
    if log.command is not None and len(log.command.time) > 1:
        return log.command, False
    if log.motors is not None and len(log.motors.time) > 1:
        return log.motors, True
    raise ConfigError(f"{log.source}: neither torque commands nor motor outputs are logged")


def _cut(log: FlightLog, command: LogSignal, spans: Spans) -> list[Stretch]:
    return [cut_stretch(log.gyro, command, begin, end) for begin, end in spans]


def _axis_data(stretches: list[Stretch], square: bool) -> list[AxisData]:
    """Return the measurements of each axis."""
    trim = stretches[0].command.shape[1] - 1
    channels = [[*range(trim), trim] if square else [i, trim] for i in range(3)]
    return [AxisData(stretches=stretches, axis=i, channels=each, square=square) for i, each in enumerate(channels)]


def _search(data: list[AxisData]) -> list[Array]:
    """Return rough parameters of each axis, the best of several beginnings."""
    tilts = [maximise(data[:2], _guess(data[:2], lag, delay), rounds=5) for lag in _LAGS for delay in _DELAYS]
    tilt = min(tilts, key=lambda fit: fit.cost)
    begins = [(float(np.exp(tilt.theta[LAG])), float(tilt.theta[DELAY])), (_LAGS[0], _DELAYS[0])]
    yaws = [maximise(data[2:], _guess(data[2:], *begin), rounds=5) for begin in begins]
    return [tilt.axis(0), tilt.axis(1), min(yaws, key=lambda fit: fit.cost).axis(0)]


def _fit_axes(data: list[AxisData], dt: float, near: list[Array]) -> list[_Axis]:
    """Return the fit of each axis, found from parameters `near` it; its curves have samples `dt` [s] apart.

    Lag and delay are shared by roll and pitch, and by yaw if its own are not far from theirs: the rotors' inertia
    can make it faster.
    """
    fits = [maximise(data[:2], np.concatenate([near[0], near[1][SHARED:]])), maximise(data[2:], near[2])]
    pooled = maximise(data, np.concatenate([fits[0].theta, fits[1].theta[SHARED:]]))
    if pooled.cost - sum(fit.cost for fit in fits) < _APART:
        fits = [pooled]
    axes = []
    for fit in fits:
        replicates = bootstrap(fit)
        for one, at, linear in zip(fit.axes, places(fit.axes), fit.linear, strict=True):
            theta, left = fit.theta[at], float(np.mean(linear.error**2))
            curves = make_curves(one, theta, dt)
            axes.append(_Axis(data=one, theta=theta, replicates=replicates[:, at], unexplained=left, curves=curves))
    return axes


def _guess(group: list[AxisData], lag: float, delay: float) -> Array:
    """Return a first guess of all parameters."""
    parts = [np.array([np.log(lag), delay])]
    for data in group:
        rate, dt = data.rate(), float(np.median(np.diff(data.time)))
        noise = float(np.var(np.diff(rate, 2))) / 6.0 + 1e-14
        power = float(np.var(np.diff(rate))) / dt**2 + 1e-8
        theta = np.array([np.log(lag), delay, 0.3, *np.log([noise, 0.5, power, 30.0, 10.0 * power])])
        parts.append(solve_gains(data, np.concatenate([theta, np.zeros(len(data.channels))]))[SHARED:])
    return np.concatenate(parts)


def _score_held_out(axis: _Axis, ahead: list[Stretch]) -> float:
    """Return R^2 of the prediction of stretches that the fit has not seen."""
    data = replace(axis.data, stretches=ahead)
    return make_curves(data, axis.theta, axis.curves.dt).r_squared(axis.curves.corner())


def _collect(log: FlightLog, command: LogSignal, axes: list[_Axis], held_out: list[float]) -> Identification:
    """Return the results in the form that others read."""
    leader = next((axis for axis in axes if axis.gain is not None), None)
    lag, delay = _lag_and_delay(leader, 0.5 * sample_time(command))
    slow, dt = describe_slow_log(log, command), sample_time(log.gyro)
    roll, pitch, yaw = (_estimate(axis, r2, dt, slow) for axis, r2 in zip(axes, held_out, strict=True))
    motors, motor_intervals = _motor_gains(axes)
    return Identification(
        source=log.source,
        system=log.system,
        thrust_range=_thrust_range(log),
        dt=axes[0].curves.dt,
        actuator_lag=lag,
        delay=delay,
        axes=(roll, pitch, yaw),
        command_unit=CommandUnit.NORMALISED if log.command is None else log.command_unit,
        motor_gains=motors,
        motor_intervals=motor_intervals,
        findings=(*log.findings, *_doubts(axes, leader)),
        **_support(log, axes),
    )


def _support(log: FlightLog, axes: list[_Axis]) -> dict[str, Array]:
    """Return responses and series of `Identification`, by their names there."""
    responses = [axis.curves.response(log.reference, i) for i, axis in enumerate(axes)]
    corner, omega = max(axis.curves.corner() for axis in axes), responses[0].omega
    measured, predicted = zip(*(axis.curves.accelerations(corner) for axis in axes), strict=True)
    return {
        "omega": omega,
        "response": np.array([each.response for each in responses]),
        "model": np.array([model_response(axis.theta, omega, np.abs(axis.theta[GAINS:-1]).sum()) for axis in axes]),
        "coherence": np.array([each.coherence for each in responses]),
        "time": np.concatenate(axes[0].curves.time),
        "acceleration": np.column_stack(measured),
        "predicted": np.column_stack(predicted),
    }


def _lag_and_delay(axis: _Axis | None, hold: float) -> tuple[Interval | None, Interval | None]:
    """Return actuator lag and delay [s] for commands that may be held for up to twice `hold` [s], if any axis tells."""
    if axis is None:
        return None, None
    lag = widen(interval(axis.theta, axis.replicates, lambda p: np.exp(p[..., LAG])), _BLUR * hold)
    held = widen(interval(axis.theta, axis.replicates, lambda p: p[..., DELAY]), _BLUR * hold)
    return lag, Interval(held.low, held.nominal + 0.5 * hold, held.high + hold)


def _estimate(axis: _Axis, held_out: float, dt: float, slow: str) -> AxisEstimate:
    """Return the numbers of one axis; `dt` [s] is that of the gyro's samples, `slow` blames a slow log."""
    gain, theta = axis.gain, axis.theta
    damping = interval(theta, axis.replicates, lambda p: np.maximum(p[..., DAMPING], 0.0))
    return AxisEstimate(
        gain=gain,
        damping=None if gain is None else damping,
        noise=float(np.sqrt(2.0 * np.exp(theta[NOISE]) * dt)),
        disturbance_rms=disturbance_rms(axis.curves, theta),
        disturbance_corner=disturbance_corner(theta),
        held_out_r2=None if gain is None else held_out,
        advice="" if gain is not None else slow or _advise(axis),
    )


def _advise(axis: _Axis) -> str:
    """Return the reason why an axis is not identified, and the manoeuvre that would excite it."""
    name, gain = _AXES[axis.data.axis], axis.wide_gain
    share = max(axis.curves.r_squared(axis.curves.corner()), 0.0)
    reach = max(gain.high - gain.nominal, gain.nominal - gain.low) / max(gain.nominal, 1e-300)
    if share > _MOSTLY:
        return (
            f"{name} is not identified: the command explains {100.0 * share:.0f} % of its acceleration, but not always "
            "alike. The log may hold more than the flight: cut that off (--from, --to)"
        )
    known = f"its gain is known to {100.0 * reach:.0f} % only" if reach < 1.0 else "its gain can't be told from 0"
    return (
        f"{name} is not excited: the command explains {100.0 * share:.0f} % of its acceleration, {known}. Fly steps of "
        f"10 deg of {name}, a second each, or a chirp of .5 to 8 Hz, for 30 s; log gyro and torque command at 250 Hz"
    )


def _thrust_range(log: FlightLog) -> float:
    """Return the share [-] of the largest thrust that motors span: ArduPilot's has limits, by default .15 and .95."""
    if log.system != "ardupilot":
        return 1.0
    low, high = log.parameters.get("MOT_SPIN_MIN", 0.15), log.parameters.get("MOT_SPIN_MAX", 0.95)
    return high - low if 0.0 <= low < high <= 1.0 else 0.8


def _motor_gains(axes: list[_Axis]) -> tuple[Array | None, Array | None]:
    """Return the gains (3, m) of motors and their intervals (3, m, 2)."""
    if not axes[0].data.square:
        return None, None
    gains = np.array([axis.theta[GAINS:-1] for axis in axes])
    ends = np.array([np.quantile(axis.replicates[:, GAINS:-1], [0.025, 0.975], axis=0).T for axis in axes])
    return gains, np.asarray(np.sort(np.dstack([ends, gains[..., None]]), axis=-1)[..., [0, -1]])


def _doubts(axes: list[_Axis], leader: _Axis | None) -> list[str]:
    """Return the doubts about the results, a line each."""
    doubts = [_AXES[axis.data.axis] + " is not identified" for axis in axes if axis.gain is None]
    if leader is not None and axes[2].gain is not None and axes[2].theta[LAG] != leader.theta[LAG]:
        lag = np.exp(axes[2].theta[LAG])
        doubts.append(f"yaw answers with a lag of {lag:.3f} s, unlike roll and pitch: the lag told is of those")
    if coloured := _find_coloured_axes(axes):
        doubts.append(f"{_FILTERED} ({', '.join(coloured)}): lag, delay and gains may be off by more")
    return doubts
