"""Identification of a vehicle from a flight log: gains, actuator lag, delay, damping, disturbance and gyro noise."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from firmware_model.errors import ConfigError
from firmware_model.types import AXES
from gustproof.logs.identify.bootstrap import bootstrap, interval, widen
from gustproof.logs.identify.curves import Curves, disturbance_corner, disturbance_rms, make_curves, model_response
from gustproof.logs.identify.filtered_command import filter_command
from gustproof.logs.identify.identification import AxisEstimate, Identification, Interval
from gustproof.logs.identify.instrument import ByReference, gain_by_reference
from gustproof.logs.identify.likelihood import (
    DAMPING,
    DELAY,
    DELAY_PRIOR,
    GAINS,
    LAG,
    NOISE,
    SHARED,
    AxisData,
    Fit,
    at_bound,
    is_prompt,
    maximise,
    places,
    solve_gains,
)
from gustproof.logs.identify.rates import describe_cure, describe_slow_log, is_whole
from gustproof.logs.identify.sparse_command import Filled, fill_command
from gustproof.logs.identify.stretches import (
    BIN,
    NEVER_FLEW,
    SHORTEST,
    Stretch,
    cut_stretch,
    find_stretches,
    hold_out,
    limit_time,
    sample_time,
)
from gustproof.logs.read.flight_log import CommandUnit, FlightLog, LogSignal
from gustproof.types import Array

_ENOUGH, _BRIEF = 150.0, 20.0  # [s] of a long log that are used, and for the first search
_HOPELESS = 8.0  # [Hz] of a log that is refused at once: a piece of it has too few samples for any filter
_WANTED = 30.0  # [s] in the air, below which a loose gain is blamed on that
_LAGS, _DELAYS = (0.015, 0.04, 0.1), (0.002, 0.02)  # [s] where the search starts
_SURPRISE, _SCALES = 4.0, (0.4, 2.5)  # [-] of pieces held out, beyond which the model is none of this vehicle
_MOST_DAMPING = 10.0  # [1/s] of a multirotor, whose rotors' drag gives 0 to 3
_LEAST_DAMPING = -2.0  # [1/s] below it the model lacks more than the damping's own error
_LATEST = 0.03  # [s] longest delay of output drivers and speed controllers
_LOOSE = 0.3  # [-] relative half-width above which a gain is not reported
_VAGUE, _EVIDENT = 0.1, 10.0  # the same, where the command adds less than this log likelihood to what is held out
_ACTS = 100.0  # of evidence, beyond which a loose gain is none of a hover: a still one has 50, real flights 400 to 1000
_WHITE = 1e-3  # of the prediction errors' mean square; white noise below it means that a filter took it away
_ALIKE, _COLOURED = 0.05, 0.15  # correlation of errors that follow each other, to thin samples at, and to warn of
_GUESSED = 0.4  # share of the quick commands filled in, below which the log's rate is to blame
_MOSTLY = 0.5  # of the accelerations explained, and yet a loose gain: not all of it is flight
_TRADED = 0.5  # spread of a gain over the lag by that of the gain, below which the two trade off
_HIDDEN = "the autopilot's answer to the gyro hides the vehicle's to the command"
_FILTERED = "gyro: filtered before it is logged"
_APART_S = (0.008, 0.012)  # between gyro samples behind a filter: their noise is nearly white again
_TOLD, _SPREAD = 3.0, 2.0  # standard errors beyond which set-points tell of prediction errors, and that a gain spans
_FLOOR = 0.01  # of a gain: what the model leaves out, such as gyroscopic moments
_BLUR = 0.2  # of half a sample of the command: noise above its Nyquist frequency folds down and looks like lag
_FILLED_SPREAD = 1.3  # spread of real errors with commands that are filled in by that of the replicates, by simulation
_GUESSED_SPREAD = 1.65  # the same where the gyro tells less of them than `_GUESSED`, as in ArduPilot's default logs
_FILLED = 0.3  # of the spacing of commands that are filled in between: lag and delay of 50 Hz are 6 ms off
_LEAST_LAG = 0.00025  # [s] that stands for none
_LEAST_SHAKEN = 1e-4  # [rad/s^2] of a disturbance: below it the fit has found none
_APART = 6.0  # loss of log likelihood by one lag and delay for all axes: beyond it (p = .002) yaw has its own
_ASSUMED = 0.5  # of the delay's variance left by the flight, beyond which what was known before tells more
_KNOWN_LAG, _FAR_APART = 0.5, 12.0  # of a lag's logarithm, within which it is told; the loss where yaw's own is not

Spans = Sequence[tuple[float, float]]


class _HeldOut(NamedTuple):
    """Test of a fit on pieces of the flight that it has not seen."""

    r_squared: float
    """[-] of the acceleration predicted from the command alone."""
    surprise: float
    """[-] mean square of the prediction errors over their variance by the model: 1 if it holds."""
    scale: float
    """[-] factor of the gain with which the command predicts best: 1 if it holds."""
    evidence: float
    """[-] log likelihood that the command adds to a prediction from the rate's own past."""


@dataclass(slots=True, kw_only=True, eq=False)
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
    likeness: float = 0.0
    """[-] correlation of prediction errors that follow each other."""
    curves: Curves
    """Series."""
    held_out: "_HeldOut | None" = None
    """Test on the pieces of the flight that its fit has not seen."""
    filled: float | None = None
    """[-] share of the quick commands that the gyro fills in: the answer to them hides behind that; else `None`."""
    by_reference: ByReference | None = None
    """Gain by the set-points, if they tell that the disturbance is not of the model's shape."""
    assumed: float = 0.0
    """[-] share of the delay's variance before the flight that the flight leaves."""
    outruns: float = 0.0
    """[s] lag of roll and pitch, if this is a yaw that shows none: rotors that speed up turn it by their inertia."""

    @property
    def is_noise_gone(self) -> bool:
        """True if next to nothing of the prediction errors is white: a filter took the gyro's noise away."""
        return bool(np.exp(self.theta[NOISE]) < _WHITE * self.unexplained)

    @property
    def wide_gain(self) -> Interval:
        """[rad/s^2 per unit] sum of the channels' magnitudes, however uncertain."""
        gain = interval(self.theta, self.replicates, lambda p: np.abs(p[..., GAINS:-1]).sum(axis=-1))
        low, nominal, high = widen(gain, _FLOOR * gain.nominal)
        if self.by_reference is None:
            return Interval(low, nominal, high)
        middle, spread = self.by_reference.scale, _SPREAD * self.by_reference.deviation
        return Interval(min(low, (middle - spread) * nominal), nominal, max(high, (middle + spread) * nominal))

    @property
    def doubt(self) -> str:
        """Reason why the model is none of this vehicle, whatever its gain; empty if there is none."""
        test = self.held_out
        if at_bound(self.theta) or (self.filled is not None and is_prompt(self.theta)):
            return "its lag ends at a bound of the search, which is no estimate"
        if self.outruns:
            told = f"it answers at once, where roll and pitch lag by {1e3 * self.outruns:.0f} ms"
            return f"{told}: the inertia of rotors that speed up hides the gain of their drag"
        if hidden := self._hidden():
            return hidden
        if test is not None and test.surprise > _SURPRISE:
            return (
                f"in pieces of the flight that the fit has not seen, errors are {math.sqrt(test.surprise):.1f} times "
                "those that the model expects: it may stand on the ground or vibrate"
            )
        if test is not None and not _SCALES[0] < test.scale < _SCALES[1]:
            return f"in pieces of the flight that the fit has not seen, its gain is {test.scale:.2g} times that"
        return ""

    def _hidden(self) -> str:
        """Return how the fit tells that it is the autopilot's answer; empty if it does not."""
        delay = interval(self.theta, self.replicates, lambda p: p[..., DELAY])
        driven = np.quantile(self.replicates[:, DAMPING], 0.975) < _LEAST_DAMPING
        turned = not (self.data.square or self.theta[GAINS] > 0.0)
        if turned or driven or self.theta[DAMPING] > _MOST_DAMPING:
            sign = ", or the command has the other sign" if turned else ""
            return f"{_HIDDEN}, as its best fit is no multirotor{sign}"
        if delay.low <= _LATEST:
            return ""
        late = f"its command would act {1e3 * delay.nominal:.0f} ms late"
        return f"{late}, which is longer than any speed controller takes: {_HIDDEN}"

    @property
    def gain(self) -> Interval | None:
        """[rad/s^2 per unit] the same; `None` if the flight does not show it."""
        low, gain, high = self.wide_gain
        evidence = math.inf if self.held_out is None else self.held_out.evidence
        loose = (_LOOSE if evidence > _EVIDENT else _VAGUE) * (1.0 if self.filled is None else _FILLED_SPREAD)
        sound = gain > 0.0 and evidence > 0.0 and not self.doubt
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
        If the log has no commands, is too short in the air, or far too slow.
    """
    if log.airborne == ():
        raise ConfigError(f"{log.source}: {NEVER_FLEW}")
    signals = {"gyro": log.gyro, "command": _find_command(log)[0]}
    if hopeless := describe_slow_log(log, signals, _HOPELESS):
        raise ConfigError(f"{log.source}: {hopeless}")
    slow = describe_slow_log(log, signals)
    filled = fill_command(log)
    return _identify(filter_command(filled.log if filled else log), progress or (lambda _: None), slow, filled)


def _identify(log: FlightLog, tell: Callable[[float], None], slow: str, filled: Filled | None) -> Identification:
    """Return the estimates of a log, whose commands may be filled in; `slow` blames its rates, where they are low."""
    command, square = _find_command(log)
    spans = limit_time(find_stretches(log, command), command, _ENOUGH)
    learnt, rest = hold_out(spans)
    if not learnt or not rest:
        short = f"too short: {3.0 * SHORTEST:g} s in the air without a gap are needed"
        raise ConfigError(f"{log.source}: {slow or short}")
    tell(0.02)
    dt = max(BIN, sample_time(log.gyro))
    near = _search(_axis_data(_cut(log, command, limit_time(learnt, command, _BRIEF)), square))
    tell(0.3)
    trained = _fit_axes(_axis_data(_cut(log, command, learnt), square), dt, near)
    if (further := _next_spacing(trained, log.gyro, is_filled=filled is not None)) is not None:
        return _identify(_thin(log, further), tell, slow, filled)
    tell(0.6)
    axes = _fit_axes(_axis_data(_cut(log, command, spans), square), dt, [axis.theta for axis in trained])
    tell(0.9)
    ahead = _cut(log, command, rest)
    for axis, seen in zip(axes, trained, strict=True):
        axis.held_out = _test_held_out(seen, ahead)
        if filled is not None:
            axis.filled = filled.shares[axis.data.axis]
            middle = np.median(axis.replicates, axis=0)
            axis.replicates = middle + _widening(axis.filled) * (axis.replicates - middle)
    if log.reference is not None and filled is None:
        _ask_reference(axes, log.reference)
    return _collect(log, command, axes, slow, 0.0 if filled is None else filled.step)


def _ask_reference(axes: list[_Axis], reference: LogSignal) -> None:
    """Keep each axis' gain by the set-points, if of one they tell more than the model of its disturbance allows."""
    found = [gain_by_reference(axis.data, axis.theta, reference) for axis in axes]
    if max(each.surprise for each in found) > _TOLD:
        for axis, each in zip(axes, found, strict=True):
            axis.by_reference = each


def _widening(share: float) -> float:
    """Return the factor [-] on the spread of replicates, of commands of which the gyro tells a `share` [-]."""
    return _FILLED_SPREAD if share >= _GUESSED else _GUESSED_SPREAD


def _next_spacing(axes: list[_Axis], gyro: LogSignal, *, is_filled: bool) -> float | None:
    """Return the next spacing [s] of gyro samples if their noise is coloured; `None` if it is not, or at the last.

    Noise that a filter has coloured, and that the loop hands on to the command, draws the lag to an end of its search.
    """
    wider = [each for each in _APART_S if round(each / sample_time(gyro)) > 1]
    ends = any(at_bound(axis.theta) or (is_filled and is_prompt(axis.theta)) for axis in axes[:2])
    return wider[0] if wider and (ends or _find_coloured_axes(axes, _ALIKE)) else None


def _thin(log: FlightLog, spacing: float) -> FlightLog:
    """Return the log with a gyro sample in each `spacing` [s]."""
    step = max(2, round(spacing / sample_time(log.gyro)))  # 1 would leave it as it is, for ever
    gyro = LogSignal(time=log.gyro.time[::step], values=log.gyro.values[::step])
    told = [line for line in log.findings if not line.startswith(_FILTERED)]
    return replace(log, gyro=gyro, findings=(*told, f"{_FILTERED}: one sample in {1e3 * spacing:g} ms is used"))


def _find_coloured_axes(axes: list[_Axis], alike: float = _COLOURED) -> list[str]:
    """Return the axes of the gyro whose noise is not white: a filter took it away, or samples share it."""
    return [AXES[axis.data.axis] for axis in axes if axis.is_noise_gone or axis.likeness > alike]


def _find_command(log: FlightLog) -> tuple[LogSignal, bool]:
    """Return the commands to explain the rates by, and whether they are of motors."""
    if log.command is not None and len(log.command.time) > 1:
        return log.command, False
    if log.motors is not None and len(log.motors.time) > 1:
        return log.motors, True
    raise ConfigError(f"{log.source}: neither torque commands nor motor outputs are logged: {describe_cure(log)}")


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
    can make it faster. A yaw that tells its sum of both alone shares them as long as that fits nearly as well.
    """
    fits = [maximise(data[:2], np.concatenate([near[0], near[1][SHARED:]])), maximise(data[2:], near[2])]
    pooled = maximise(data, np.concatenate([fits[0].theta, fits[1].theta[SHARED:]]))
    if pooled.cost < fits[0].cost + fits[1].cost:  # which the best of both can't be: yaw had stopped short
        fits[1] = maximise(data[2:], pooled.axis(2))
    loss = pooled.cost - sum(fit.cost for fit in fits)
    if loss < _APART or (loss < _FAR_APART and not _tells_lag(fits[1])):
        fits = [pooled]
    axes = []
    for fit in fits:
        replicates, assumed = bootstrap(fit), fit.assumed_delay()
        for one, at, linear in zip(fit.axes, places(fit.axes), fit.linear, strict=True):
            theta, left = fit.theta[at], float(np.mean(linear.error**2))
            curves = make_curves(one, theta, dt)
            alike = float(np.mean(linear.error[1:] * linear.error[:-1])) / max(left, 1e-300)  # of a gyro that is still
            found = _Axis(
                data=one,
                theta=theta,
                replicates=replicates[:, at],
                unexplained=left,
                likeness=alike,
                curves=curves,
                assumed=assumed,
            )
            axes.append(found)
    if is_prompt(axes[2].theta) and not is_prompt(axes[0].theta):
        axes[2].outruns = float(np.exp(axes[0].theta[LAG]))
    return axes


def _tells_lag(fit: Fit) -> bool:
    """Return whether a fit tells lag and delay apart."""
    return not at_bound(fit.theta) and float(np.std(bootstrap(fit)[:, LAG])) < _KNOWN_LAG


def _guess(group: list[AxisData], lag: float, delay: float) -> Array:
    """Return a first guess of all parameters."""
    parts = [np.array([np.log(lag), delay])]
    for data in group:
        rate, dt = data.rate, float(np.median(np.diff(data.time)))
        noise = float(np.var(np.diff(rate, 2))) / 6.0 + 1e-14
        power = float(np.var(np.diff(rate))) / dt**2 + 1e-8
        theta = np.array([np.log(lag), delay, 0.3, *np.log([noise, 0.5, power, 30.0, 10.0 * power])])
        parts.append(solve_gains(data, np.concatenate([theta, np.zeros(len(data.channels))]))[SHARED:])
    return np.concatenate(parts)


def _test_held_out(axis: _Axis, ahead: list[Stretch]) -> _HeldOut:
    """Return how a fit predicts stretches that it has not seen.

    In closed loop the command answers the disturbance, so R^2 of the acceleration by the command alone may be low, even
    negative, for the true model. Errors of the prediction are white then all the same, and their size is expected.
    """
    data = replace(axis.data, stretches=ahead)
    found, gains = data.predict(axis.theta), axis.theta[GAINS:]
    trim, caused = found.errors[:, 0] - gains[-1] * found.errors[:, -1], found.errors[:, 1:-1] @ gains[:-1]
    left = trim - caused
    return _HeldOut(
        r_squared=make_curves(data, axis.theta, axis.curves.dt).r_squared(axis.curves.corner()),
        surprise=float(np.mean(left**2 / found.variance)),
        scale=float(np.sum(trim * caused / found.variance) / max(np.sum(caused**2 / found.variance), 1e-300)),
        evidence=0.5 * float(np.sum((trim**2 - left**2) / found.variance)),
    )


def _collect(log: FlightLog, command: LogSignal, axes: list[_Axis], slow: str, sampled: float) -> Identification:
    """Return the results in the form that others read; commands `sampled` [s] apart are filled in, at 0 none are."""
    told = [axis for axis in axes if axis.gain is not None]
    if slow and len(told) < len(axes):  # intervals of the others miss the truth in a quarter of such logs
        told = []
    lag, delay, lateness = _lateness(
        told,
        0.5 * sample_time(command),
        sampled=sampled,
        is_held=log.system == "gustproof" or is_whole(log, log.command),
    )
    dt = sample_time(log.gyro)
    advice = ["" if axis in told else slow or _advise(axis, describe_cure(log)) for axis in axes]
    roll, pitch, yaw = (_estimate(axis, dt, its_own) for axis, its_own in zip(axes, advice, strict=True))
    motors, motor_intervals = _motor_gains(axes if told else [])
    return Identification(
        source=log.source,
        system=log.system,
        thrust_range=_thrust_range(log),
        dt=axes[0].curves.dt,
        actuator_lag=lag,
        delay=delay,
        lateness=lateness,
        axes=(roll, pitch, yaw),
        command_unit=CommandUnit.NORMALISED if log.command is None else log.command_unit,
        motor_gains=motors,
        motor_intervals=motor_intervals,
        findings=(*log.findings, *_doubts(axes, told)),
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


def _lateness(told: list[_Axis], hold: float, *, sampled: float, is_held: bool) -> list[Interval | None]:
    """Return actuator lag, delay and their sum [s], as far as the axes tell; each interval spans those of all.

    Commands act for twice `hold` [s], half of which is no delay where they are filled in. What is filled in, between
    commands that are `sampled` [s] apart, is in error, and lag and delay with it. Else, at 0, they may be held, and in
    our own flights they are: then the nominal delay has nothing of the hold. A lag that is not seen is as short as the
    sum, which is known: more would stand in every loop.
    """
    if not told:
        return [None, None, None]
    held = 0.0 if is_held else 0.5 * hold
    least, usual, blur = (hold, hold, _FILLED * sampled) if sampled else (0.0, held, _BLUR * hold)
    found = []
    for of, later in ((_lag, 0.0), (_delay, 1.0), (lambda p: _lag(p) + _delay(p), 1.0)):
        each = [widen(interval(axis.theta, axis.replicates, of), blur) for axis in told]
        low, high = min(one.low for one in each), max(one.high for one in each)
        found.append(Interval(low + later * least, each[0].nominal + later * usual, high + later * hold))
    lag, delay, both = found
    low, nominal, high = max(lag.low, _LEAST_LAG), lag.nominal, lag.high
    if any(is_prompt(axis.theta) for axis in told):
        nominal = min(nominal, max(both.nominal - max(delay.nominal, 0.0), _LEAST_LAG))
        low, high = min(low, 0.75 * nominal), max(high, both.high)
    return [Interval(low, nominal, high), delay, both]


def _delay(theta: Array) -> Array:
    return np.asarray(theta[..., DELAY])


def _lag(theta: Array) -> Array:
    return np.asarray(np.exp(theta[..., LAG]))


def _estimate(axis: _Axis, dt: float, advice: str) -> AxisEstimate:
    """Return the numbers of one axis, identified if there is no advice; `dt` [s] is that of the gyro's samples."""
    gain, theta = None if advice else axis.gain, axis.theta
    free = theta if theta[DAMPING] > 0.0 else np.median(axis.replicates, axis=0)  # one at its bound is no estimate
    damping = interval(free, axis.replicates, lambda p: p[..., DAMPING])
    shaken = disturbance_rms(axis.curves, theta)
    is_seen = gain is not None and shaken > _LEAST_SHAKEN
    return AxisEstimate(
        gain=gain,
        damping=None if gain is None else damping,
        noise=None if axis.is_noise_gone else float(np.sqrt(2.0 * np.exp(theta[NOISE]) * dt)),
        disturbance_rms=shaken if is_seen else None,
        disturbance_corner=disturbance_corner(theta) if is_seen else None,
        held_out_r2=None if gain is None or axis.held_out is None else axis.held_out.r_squared,
        advice=advice,
    )


def _advise(axis: _Axis, cure: str) -> str:
    """Return the reason why an axis is not identified, and the settings and the manoeuvre that `cure` it."""
    name, gain = AXES[axis.data.axis], axis.wide_gain
    manoeuvre = f"Fly steps of 10 deg of {name}, a second each, or a chirp of .5 to 8 Hz, for 30 s; {cure}"
    if axis.filled is not None and axis.filled < _GUESSED:
        guessed = (
            f"of what its command does between two logged samples, the gyro tells {100.0 * axis.filled:.0f} % only"
        )
        return f"{name} is not identified, as the log is too slow: {guessed}: {cure} and fly again"
    if axis.doubt:
        return f"{name} is not identified: {axis.doubt}" + ("" if axis.outruns else f". {manoeuvre}")
    share = max(axis.curves.r_squared(axis.curves.corner()), 0.0)
    reach = max(gain.high - gain.nominal, gain.nominal - gain.low) / max(gain.nominal, 1e-300)
    aloft = sum(float(each.time[-1] - each.time[0]) for each in axis.data.stretches)
    if share > _MOSTLY and aloft < _WANTED:
        known = f"its gain is known to {100.0 * reach:.0f} % only, by {aloft:.0f} s in the air"
        return f"{name} is not identified: {known}. Fly a minute or more. {manoeuvre}"
    if share > _MOSTLY:
        return (
            f"{name} is not identified: the command explains {100.0 * share:.0f} % of its acceleration, but not always "
            f"alike. If the log holds more than the flight, cut that off (--from, --to). If not: {manoeuvre}"
        )
    return f"{_describe_loose(axis, name, share, reach)}. {manoeuvre}"


def _describe_loose(axis: _Axis, name: str, share: float, reach: float) -> str:
    """Return how little is known of a gain: where its command acts, R^2 of closed loop is no reason."""
    if axis.by_reference is not None:
        return f"{name} is not identified: its gain is known to {100.0 * reach:.0f} % only{_describe_trade(axis)}"
    known = f"its gain is known to {100.0 * reach:.0f} % only" if reach < 1.0 else "its gain can't be told from 0"
    if reach >= 1.0 or axis.held_out is None or axis.held_out.evidence <= _ACTS:
        return f"{name} is not excited: the command explains {100.0 * share:.0f} % of its acceleration, {known}"
    return f"{name} is not identified: {known}, though it acts on the rate{_describe_trade(axis)}"


def _describe_trade(axis: _Axis) -> str:
    """Return what a loose gain trades off with; empty if its ratio to the lag is no better known than itself."""
    gain = axis.wide_gain
    if axis.by_reference is not None:
        return f": by the set-points alone it is {axis.by_reference.scale:.2g} times that of the fit"
    ratio = interval(axis.theta, axis.replicates, lambda p: np.abs(p[..., GAINS:-1]).sum(axis=-1) / _lag(p))
    loose, tight = (max(each.high - each.nominal, each.nominal - each.low) / each.nominal for each in (gain, ratio))
    if tight > _TRADED * loose:
        return ""
    corner = 1.0 / (2.0 * math.pi * float(_lag(axis.theta)))
    return (
        f": it trades off with the lag, their ratio is known to {100.0 * tight:.0f} %. The command moves above "
        f"{corner:.0f} Hz alone, where more gain and more lag look alike"
    )


def _thrust_range(log: FlightLog) -> float:
    """Return the share [-] of the largest thrust that motors span: ArduPilot's has limits, by default .15 and .95."""
    if log.system != "ardupilot":
        return 1.0
    low, high = log.parameters.get("MOT_SPIN_MIN", 0.15), log.parameters.get("MOT_SPIN_MAX", 0.95)
    return high - low if 0.0 <= low < high <= 1.0 else 0.8


def _motor_gains(axes: list[_Axis]) -> tuple[Array | None, Array | None]:
    """Return the gains (3, m) of motors and their intervals (3, m, 2)."""
    if not axes or not axes[0].data.square:
        return None, None
    gains = np.array([axis.theta[GAINS:-1] for axis in axes])
    ends = np.array([np.quantile(axis.replicates[:, GAINS:-1], [0.025, 0.975], axis=0).T for axis in axes])
    return gains, np.asarray(np.sort(np.dstack([ends, gains[..., None]]), axis=-1)[..., [0, -1]])


def _doubts(axes: list[_Axis], told: list[_Axis]) -> list[str]:
    """Return the doubts about the results, a line each; `told` are the axes that are identified."""
    doubts = [AXES[axis.data.axis] + " is not identified" for axis in axes if axis not in told]
    lags = [float(axis.theta[LAG]) for axis in told]
    if lags and lags[-1] != lags[0]:
        doubts.append(
            f"yaw answers with a lag of {math.exp(lags[-1]):.3f} s, unlike roll and pitch: the lag told is of those, "
            "its interval spans both"
        )
    if driven := [axis for axis in told if np.quantile(axis.replicates[:, DAMPING], 0.975) < 0.0]:
        names = ", ".join(AXES[axis.data.axis] for axis in driven)
        doubts.append(f"{names}: a damping below 0 would fit best, which no vehicle has: the model lacks something")
    if any(is_prompt(axis.theta) for axis in told):
        doubts.append("lag: none is seen, as of simulated motors without one: what is left of the sum stands for it")
    if (known := [axis.by_reference for axis in axes]) and known[0] is not None:
        scales = ", ".join(f"{each.scale:.2f}" for each in known if each is not None)
        doubts.append(
            f"gains: by the set-points alone they are {scales} times those of the fit, so their intervals span both: "
            "the disturbance is not of the model's shape"
        )
    return doubts + _doubt_delay(told) + _doubt_noise(axes)


def _doubt_delay(told: list[_Axis]) -> list[str]:
    """Return a line on a delay that stands on what is usual more than on the log; none if it does not."""
    mean, deviation = DELAY_PRIOR
    if not told or told[0].assumed < _ASSUMED or abs(told[0].theta[DELAY] - mean) > 2.0 * deviation:
        return []
    usual = f"{1e3 * mean:.0f} ms, give or take {1e3 * deviation:.0f}"
    return [f"delay: assumed more than measured, from a usual {usual}: the log tells it with the lag, as a sum"]


def _doubt_noise(axes: list[_Axis]) -> list[str]:
    """Return the doubts about a gyro that was filtered before it was logged, a line each."""
    lines = []
    if gone := [AXES[axis.data.axis] for axis in axes if axis.is_noise_gone]:
        lines.append(f"gyro noise: not told of {', '.join(gone)}, as a filter took it away before it was logged")
    if coloured := _find_coloured_axes(axes):
        lines.append(f"{_FILTERED} ({', '.join(coloured)}): lag, delay and gains may be off by more")
    return lines
