"""Margins of a feedback loop: one channel at a time, and all channels of the plant's input or output at once."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gustproof.robust.lti.balancing import balance_states, separating_units
from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import (
    ComplexMatrix,
    LinearSystem,
    Lti,
    Matrix,
    as_controller,
    as_lti,
    gain,
    lft,
    sensitivity,
    series,
)
from gustproof.robust.shown import Shown

_POINTS = 400
"""Number of frequencies, evenly spaced in the logarithm, that bracket crossings beside those that eigenvalues tell."""

_LARGEST_DISK = 2.0
"""[-] the disk of this margin holds every positive gain; a larger one holds infinite gains, which no loop keeps."""

_SWEEPS = 20
"""Number of rounds over the channels that balance them; powers of two start, so that few are needed."""

_STANDING = 1e-12
"""[-] speeds below this fraction of the fastest of a loop are rounding of an integrator's, which is 0."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class LoopMargins(Shown):
    """Margins of one channel, the others closed."""

    crossover: float
    """[rad/s] highest frequency of unit loop gain; 0 if there is none."""
    phase_margin: float
    """[rad] least destabilising change of phase."""
    gain_margin: float
    """[-] least destabilising factor above 1; infinite if there is none."""
    gain_reduction_margin: float
    """[-] largest destabilising factor below 1; 0 if there is none."""
    delay_margin: float
    """[s] least destabilising additional delay."""
    Ms: float
    """[-] H-infinity norm of the sensitivity."""

    def lines(self) -> list[str]:
        """Return the margins in one line."""
        gains = f"gains {self.gain_reduction_margin:.3g} to {self.gain_margin:.3g}"
        turns = f"phase {math.degrees(self.phase_margin):.3g} deg, delay {1e3 * self.delay_margin:.3g} ms"
        return [f"Margins of a loop: Ms {self.Ms:.4g}, {gains}, {turns}, crossover {self.crossover:.4g} rad/s"]


def worst_loop(loops: Sequence[LoopMargins]) -> LoopMargins:
    """Return the worst of each margin of some loops, and their highest crossover."""
    return LoopMargins(
        crossover=max(loop.crossover for loop in loops),
        phase_margin=min(loop.phase_margin for loop in loops),
        gain_margin=min(loop.gain_margin for loop in loops),
        gain_reduction_margin=max(loop.gain_reduction_margin for loop in loops),
        delay_margin=min(loop.delay_margin for loop in loops),
        Ms=max(loop.Ms for loop in loops),
    )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Margins(Shown):
    """Margins of a loop of several channels, broken at the plant's input and at its output."""

    input: tuple[LoopMargins, ...]
    """Each plant input in turn."""
    output: tuple[LoopMargins, ...]
    """Each plant output in turn."""
    input_disk: float
    """[-] guaranteed multi-loop disk margin at the plant input."""
    output_disk: float
    """[-] guaranteed multi-loop disk margin at the plant output."""

    def lines(self) -> list[str]:
        """Return the disk margins, then a line for each loop."""
        disks = f"disk, all channels at once: {self.input_disk:.4g} at the input, {self.output_disk:.4g} at the output"
        loops = [
            f"{place} {number}: {loop.lines()[0].partition(': ')[2]}"
            for place, each in (("input", self.input), ("output", self.output))
            for number, loop in enumerate(each, 1)
        ]
        return ["Margins", disks, *loops]


def margins(G: LinearSystem, K: LinearSystem | ArrayLike) -> Margins:
    """Return the margins of the plant `G` under the stabilising controller `K` with positive feedback, `u = K y`.

    A number or matrix `K` is a gain.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, or the loop is unstable.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import margins
    >>> found = margins(ss(0.0, 1.0, 1.0, 0.0), ss(-10.0, 1.0, -20.0, 0.0)).input[0]
    >>> f"crossover {found.crossover:.2f} rad/s, Ms {found.Ms:.2f}"
    'crossover 1.96 rad/s, Ms 1.13'
    """
    plant, controller = _loop_parts(G, K)
    at_input, at_output = -series(plant, controller), -series(controller, plant)
    return Margins(
        input=input_margins(plant, controller),
        output=tuple(loop_margins(_channel(at_output, k)) for k in range(plant.n_outputs)),
        input_disk=disk_margin(at_input),
        output_disk=disk_margin(at_output),
    )


def input_margins(G: LinearSystem, K: LinearSystem) -> tuple[LoopMargins, ...]:
    """Return the margins of each input of the plant `G` alone, as `margins` does and with what it raises."""
    return tuple(loop_margins(L) for L in _input_loops(G, K))


def input_peaks(G: LinearSystem, K: LinearSystem) -> tuple[float, ...]:
    """Return the sensitivity peak [-] of each input of `G` alone: `Ms` of `input_margins`, without the rest."""
    return tuple(hinf_norm(sensitivity(L)).gain for L in _input_loops(G, K))


def _input_loops(G: LinearSystem, K: LinearSystem) -> Iterator[Lti]:
    """Yield the scalar loop of each input, the others closed; raise if the whole is unstable."""
    at_input = -series(*_loop_parts(G, K))
    if not sensitivity(at_input).is_stable():
        raise ValueError("the loop is unstable: it has no margins")
    yield from (_channel(at_input, k) for k in range(at_input.n_inputs))


def loop_margins(L: Lti) -> LoopMargins:
    """Return the margins of the stable negative-feedback loop with the scalar loop transfer `L`."""
    grid = _grid(L)
    values = L.response(grid)[:, 0, 0]
    return response_margins(
        grid, values, lambda w: complex(L.response(w)[0, 0, 0]), hinf_norm(sensitivity(L)).gain, _real_ends(L)
    )


def response_margins(
    grid: Matrix,
    values: ComplexMatrix,
    response: Callable[[float], complex],
    peak: float,
    ends: Sequence[float] = (),
) -> LoopMargins:
    """Return the margins of a stable negative-feedback loop from its response, over the frequencies of `grid`.

    Parameters
    ----------
    grid
        (n,) [rad/s] frequencies, rising, between which crossings are bracketed.
    values
        (n,) loop transfer there.
    response
        Loop transfer at any frequency [rad/s] within the grid.
    peak
        [-] largest sensitivity.
    ends
        Loop transfer where frequencies end and it is real, as at 0: a pole may leave there through the real axis.
    """
    unit_gain = _roots(grid, np.log(np.maximum(np.abs(values), 1e-300)), lambda w: math.log(abs(response(w))))
    real_axis = _roots(grid, values.imag, lambda w: response(w).imag)
    leads = [math.remainder(float(np.angle(-response(w))), 2.0 * math.pi) for w in unit_gain]
    factors = [-1.0 / value for value in (*(response(w).real for w in real_axis), *ends) if value < 0.0]
    delays = [(lead % (2.0 * math.pi)) / w for lead, w in zip(leads, unit_gain, strict=True)]
    return LoopMargins(
        crossover=max(unit_gain, default=0.0),
        phase_margin=min((abs(lead) for lead in leads), default=math.pi),
        gain_margin=min((factor for factor in factors if factor > 1.0), default=math.inf),
        gain_reduction_margin=max((factor for factor in factors if factor < 1.0), default=0.0),
        delay_margin=min(delays, default=math.inf),
        Ms=peak,
    )


def disk_margin(L: Lti) -> float:
    """Return a guaranteed multi-loop disk margin alpha of the stable negative-feedback loop `L`.

    The loop stays stable if every channel is multiplied at once by its own `(1 + delta/2) / (1 - delta/2)`,
    `|delta| < alpha`. This covers gains between `(2 - alpha) / (2 + alpha)` and its inverse, or phases up to
    `2 atan(alpha / 2)`. A margin of 2 covers every positive gain, and none is larger.

    The result is `1 / mu` with an upper bound of mu from one constant diagonal scaling over all frequencies. It holds
    without a frequency grid and is exact for uncoupled loops.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020), 78-95.
    """
    S = sensitivity(L)
    M = balance_states(Lti(A=S.A, B=S.B, C=S.C, D=S.D - 0.5 * np.eye(S.n_outputs), dt=S.dt))
    poles, least = M.poles(), math.inf
    speeds = np.abs(np.log(np.where(poles == 0.0, 1e-300, poles))) / M.dt if M.dt else np.abs(poles)
    start = np.abs(M.response(np.minimum(speeds, math.pi / M.dt) if M.dt else speeds))
    units = _scaling(np.max(np.concatenate([start, np.abs(M.D)[None]]), axis=0))
    for _ in range(4):
        M = Lti(A=M.A, B=M.B * units, C=M.C / units[:, None], D=M.D * units / units[:, None], dt=M.dt)
        peak = hinf_norm(M, accuracy=1e-6)
        least = min(least, peak.gain)
        units = _scaling(np.abs(M.response(min(peak.omega, 1e9 * np.max(speeds, initial=1.0)))[0]))
    return largest_disk(least)


def _scaling(sizes: Matrix) -> Matrix:
    """Return units (k,) of channels in which rows and columns of gains, (k, k), have equal norms (Osborne)."""
    units = separating_units(sizes)
    sizes = sizes - np.diag(np.diag(sizes))
    for _ in range(_SWEEPS):
        for k in range(len(units)):
            scaled = sizes * units / units[:, None]
            row, column = np.linalg.norm(scaled[k]), np.linalg.norm(scaled[:, k])
            if row > 0.0 and column > 0.0:  # a channel coupled one way only cannot be balanced: leave it
                units[k] *= math.sqrt(row / column)
    return units


def largest_disk(peak: float) -> float:
    """Return the disk margin of a loop whose `S - I/2` has the peak `peak` of mu."""
    return _LARGEST_DISK if _LARGEST_DISK * peak <= 1.0 else 1.0 / peak


def _loop_parts(G: LinearSystem, K: LinearSystem | ArrayLike) -> tuple[Lti, Lti]:
    """Return a plant and its controller; raise if their sizes do not fit."""
    plant = as_lti(G)
    controller = as_controller(K, plant.dt)
    if (controller.n_inputs, controller.n_outputs) != (plant.n_outputs, plant.n_inputs):
        raise ValueError(
            f"K is {controller.n_outputs} x {controller.n_inputs}, must be {plant.n_inputs} x {plant.n_outputs} for G"
        )
    return plant, controller


def _channel(L: Lti, k: int) -> Lti:
    """Return the scalar loop of channel `k` with the other channels of the negative-feedback loop `L` closed."""
    order = [k, *(j for j in range(L.n_inputs) if j != k)]
    swapped = L.subsystem(order, order)
    return lft(swapped, gain(-np.eye(L.n_inputs - 1), L.dt)).drop_unconnected() if L.n_inputs > 1 else swapped


def _real_ends(L: Lti) -> list[float]:
    """Return the scalar loop transfer at frequency 0, unless a pole is there, and at the highest frequency."""
    last = float(L.transfer(np.array([-1.0 + 0.0j]))[0, 0, 0].real) if L.dt else float(L.D[0, 0])
    still = 1.0 if L.dt else 0.0
    A = balance_states(L).A
    # singular values tell a pole at 0 that is repeated, which eigenvalues place beside 0
    sizes = np.linalg.svd(still * np.eye(L.order) - A, compute_uv=False)
    if np.min(sizes, initial=np.inf) <= _STANDING * (still + np.max(sizes, initial=0.0)):
        return [last]
    return [float(L.transfer(np.array([still + 0.0j]))[0, 0, 0].real), last]


def _grid(L: Lti) -> Matrix:
    """Return frequencies [rad/s] over the range of the loop's poles and two decades beyond, one between each crossing.

    A resonance or a notch may cross unit gain, or the real axis, twice within any even step.
    """
    closed = sensitivity(L).poles()
    if L.dt:  # of the open loop rounding leaves integrators beside z = 1
        speeds, fastest = np.abs(np.log(np.where(closed, closed, 1.0))) / L.dt, 1.0 / L.dt
    else:
        speeds = np.abs(np.concatenate([L.poles(), closed]))
        fastest = np.max(speeds, initial=0.0)
    speeds = speeds[speeds > _STANDING * fastest]
    first, last = (0.01 * np.min(speeds), 100.0 * np.max(speeds)) if speeds.size else (0.01, 100.0)
    if L.dt:
        first, last = min(first, 1e-6 / L.dt), math.pi / L.dt
    crossings = _crossings(L)
    between = np.sqrt(crossings[:-1] * crossings[1:])
    return np.union1d(np.geomspace(first, last, _POINTS), between[(between > first) & (between < last)])


def _crossings(L: Lti) -> Matrix:
    """Return frequencies [rad/s], ascending, with all at which a scalar loop has unit gain, or is real, among them.

    These are the zeros on the axis of `1 - L(-s) L(s)` and of `L(s) - L(-s)`, with two states for each of the loop's.
    A sampled loop has those of its bilinear image.
    """
    try:
        image = balance_states(bilinear_transform(L) if L.dt else L)
    except np.linalg.LinAlgError:  # a pole at half the rate: the even steps must do
        return np.zeros(0)
    A, B, C, D, none = image.A, image.B, image.C, image.D, np.zeros_like(image.A)
    unit = Lti(
        A=np.block([[A, none], [-C.T @ C, -A.T]]),
        B=np.vstack([B, -C.T @ D]),
        C=np.hstack([-D @ C, -B.T]),
        D=1.0 - D @ D,
    )
    real = Lti(A=np.block([[A, none], [none, -A]]), B=np.vstack([B, B]), C=np.hstack([C, C]), D=0.0 * D)
    omega = np.unique(np.concatenate([unit.zeros(), real.zeros()]).imag)
    omega = omega[omega > 0.0]
    return 2.0 / L.dt * np.arctan(0.5 * L.dt * omega) if L.dt else omega


def _roots(grid: Matrix, values: Matrix, function: Callable[[float], float]) -> list[float]:
    """Return a zero of `function` between each two points of `grid` where its `values` change sign."""
    changes = np.nonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))[0]
    # an absolute tolerance, which brentq has by default, is large for a slow loop
    return [
        float(scipy.optimize.brentq(function, grid[k], grid[k + 1], xtol=1e-12 * grid[k], rtol=1e-12)) for k in changes
    ]
