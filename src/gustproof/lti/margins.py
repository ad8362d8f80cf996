"""Margins of a feedback loop: one channel at a time, and all channels of the plant's input or output at once."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from gustproof.lti.norms import hinf_norm
from gustproof.lti.state_space import ComplexMatrix, LinearSystem, Lti, Matrix, as_lti, gain, lft, sensitivity, series

_POINTS = 2000
"""Number of frequencies, evenly spaced in the logarithm, between which crossings are bracketed and then refined."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopMargins:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """Margins of a loop of several channels, broken at the plant's input and at its output."""

    input: tuple[LoopMargins, ...]
    """Each plant input in turn."""
    output: tuple[LoopMargins, ...]
    """Each plant output in turn."""
    input_disk: float
    """[-] guaranteed multi-loop disk margin at the plant input."""
    output_disk: float
    """[-] guaranteed multi-loop disk margin at the plant output."""


def margins(G: LinearSystem, K: LinearSystem) -> Margins:
    """Return the margins of the plant `G` under the stabilising controller `K` with positive feedback, `u = K y`.

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
    plant, controller = as_lti(G), as_lti(K)
    at_input, at_output = -series(plant, controller), -series(controller, plant)
    return Margins(
        input=input_margins(plant, controller),
        output=tuple(loop_margins(_channel(at_output, k)) for k in range(plant.n_outputs)),
        input_disk=disk_margin(at_input),
        output_disk=disk_margin(at_output),
    )


def input_margins(G: LinearSystem, K: LinearSystem) -> tuple[LoopMargins, ...]:
    """Return the margins of each input of the plant `G` alone, as `margins` does and with what it raises."""
    at_input = -series(as_lti(G), as_lti(K))
    if not sensitivity(at_input).is_stable():
        raise ValueError("the loop is unstable: it has no margins")
    return tuple(loop_margins(_channel(at_input, k)) for k in range(at_input.n_inputs))


def loop_margins(L: Lti) -> LoopMargins:
    """Return the margins of the stable negative-feedback loop with the scalar loop transfer `L`."""
    grid = _grid(L)
    values = L.response(grid)[:, 0, 0]
    return response_margins(grid, values, lambda w: complex(L.response(w)[0, 0, 0]), hinf_norm(sensitivity(L)).gain)


def response_margins(
    grid: Matrix, values: ComplexMatrix, response: Callable[[float], complex], peak: float
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
    """
    unit_gain = _roots(grid, np.log(np.maximum(np.abs(values), 1e-300)), lambda w: math.log(abs(response(w))))
    real_axis = _roots(grid, values.imag, lambda w: response(w).imag)
    leads = [math.remainder(float(np.angle(-response(w))), 2.0 * math.pi) for w in unit_gain]
    factors = [-1.0 / response(w).real for w in real_axis if response(w).real < 0.0]
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
    `2 atan(alpha / 2)`.

    The result is `1 / mu` with an upper bound of mu from one constant diagonal scaling over all frequencies. It holds
    without a frequency grid and is exact for uncoupled loops.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020), 78-95.
    """
    S = sensitivity(L)
    M = Lti(A=S.A, B=S.B, C=S.C, D=S.D - 0.5 * np.eye(S.n_outputs), dt=S.dt)
    scale, least = np.ones(M.n_outputs), math.inf
    for _ in range(4):
        scaled = Lti(A=M.A, B=M.B / scale, C=scale[:, None] * M.C, D=scale[:, None] * M.D / scale, dt=M.dt)
        peak = hinf_norm(scaled, accuracy=1e-6)
        least = min(least, peak.gain)
        omega = min(peak.omega, 1e9)
        scale = scale * _balance(np.abs(scaled.response(omega)[0]))
    return 1.0 / least


def _balance(M: Matrix) -> Matrix:
    """Return the diagonal scaling that gives rows and columns of `M` equal norms (Osborne)."""
    scale: Matrix = np.ones(M.shape[0])
    off_diagonal = M - np.diag(np.diag(M))
    for _ in range(10):
        for k in range(M.shape[0]):
            scaled = scale[:, None] * off_diagonal / scale
            row, column = np.linalg.norm(scaled[k]), np.linalg.norm(scaled[:, k])
            # a channel coupled one way only cannot be balanced: leave it
            if row > 1e-12 * np.max(M) and column > 1e-12 * np.max(M):
                scale[k] *= math.sqrt(column / row)
    return scale


def _channel(L: Lti, k: int) -> Lti:
    """Return the scalar loop of channel `k` with the other channels of the negative-feedback loop `L` closed."""
    order = [k, *(j for j in range(L.n_inputs) if j != k)]
    swapped = L.subsystem(order, order)
    return lft(swapped, gain(-np.eye(L.n_inputs - 1), L.dt)).drop_unconnected() if L.n_inputs > 1 else swapped


def _grid(L: Lti) -> Matrix:
    poles = np.abs(L.poles())
    if L.dt:
        return np.geomspace(1e-6 / L.dt, math.pi / L.dt, _POINTS)
    poles = poles[poles > 0.0]
    return np.geomspace(0.01 * np.min(poles, initial=1.0), 100.0 * np.max(poles, initial=1.0), _POINTS)


def _roots(grid: Matrix, values: Matrix, function: Callable[[float], float]) -> list[float]:
    """Return a zero of `function` between each two points of `grid` where its `values` change sign."""
    changes = np.nonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))[0]
    return [float(scipy.optimize.brentq(function, grid[k], grid[k + 1], rtol=1e-12)) for k in changes]
