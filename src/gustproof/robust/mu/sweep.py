"""Upper bounds at every frequency: bands on which scalings prove a level, added until they cover the axis."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gustproof.robust.lti.balancing import balance_states
from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.norms import Peak, hinf_norm
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.mu.scalings import best_scalings
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import DeltaBlock, FullBlock, columns, rows
from gustproof.robust.uncertain.units import balance

PERFORMANCE = "performance"
"""Name of the full block that closes inputs and outputs of a system."""
_BANDS = 400
"""Most bands; if they do not suffice, nothing is proved and the upper bound is infinite."""
_PATIENCE = 40
"""Bands of best scalings after which modest ones are tried too where mu is far below the level."""
_COARSE = 0.05
"""[-] accuracy of scalings that have to prove a level only."""
_DEEP = 0.5
"""[-] share of the level below which scalings are good enough: where mu is near 0, the best ones are far."""
_FAR_BELOW = 0.7
"""[-] share of the level below which mu is far below it."""
_MIN_GAP = 1e-4
"""[-] relative width of a gap below which mu is assumed to jump inside."""
_ROUNDING = 1e-6
"""[-] relative amount by which bands are computed for a lower level than the returned one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bracket:
    """Lower and upper bound on a largest value over all frequencies and the whole family."""

    lower: float
    """[-] value attained by `delta` at `omega`."""
    upper: float
    """[-] value never exceeded, up to rounding; infinite if nothing was proved."""
    omega: float
    """[rad/s] frequency of the lower bound."""
    delta: Mapping[str, ArrayLike]
    """Value of each block for the lower bound, a number or a complex matrix; norm 1 is the edge of the family."""

    @property
    def gap(self) -> float:
        """[-] upper over lower bound, less 1."""
        if self.lower == self.upper:
            return 0.0
        return self.upper / self.lower - 1.0 if self.lower > 0.0 else math.inf


def sweep(
    M: Lti, blocks: tuple[DeltaBlock, ...], *, gain: bool, accuracy: float, wanted: float | None = None
) -> tuple[float, list[float]]:
    """Return a level that holds at every frequency, and the frequencies of the largest levels found, largest first.

    Parameters
    ----------
    M
        Continuous system, stable, closed completely by `blocks`.
    blocks
        Blocks of Delta; with `gain` the last one is the performance channel.
    gain
        True for the gain of the last block, instead of mu.
    accuracy
        [-] relative distance of the level from the least one of D-G scalings.
    wanted
        [-] Level to prove, not the least one. The search ends where it can't be, with an infinite level.

    Raises
    ------
    ValueError
        If `M` is unstable or there are no blocks.
    """
    if not blocks:
        raise ValueError("there is nothing uncertain")
    require_stable(M)
    units = balance(M, blocks[:-1] if gain else blocks)
    output = units.channels.output if gain else 1.0
    balanced = units.change(M, output=output)
    if not gain and hinf_norm(balanced).gain == 0.0:
        return 0.0, [0.0]
    if wanted is None:
        level, grid = _sweep(balanced, blocks, gain=gain, accuracy=accuracy)
    else:
        goal = (1.0 - _ROUNDING) * wanted / output
        level, grid = _prove(balanced, blocks, gain=gain, accuracy=accuracy, level=goal)
    return output * level, grid


def require_search(accuracy: float, boxes: int) -> None:
    """Raise ValueError unless a search has an accuracy between 0 and 1 and a number of boxes."""
    if not 0.0 < accuracy < 1.0:
        raise ValueError(f"accuracy is {accuracy!r}, must be between 0 and 1")
    if not (isinstance(boxes, (int, np.integer)) and boxes >= 1):
        raise ValueError(f"boxes is {boxes!r}, must be a whole number, 1 or more")


def require_stable(M: Lti) -> None:
    """Raise ValueError unless a continuous system is stable at Delta = 0."""
    if not M.is_stable():
        pole = max(M.poles(), key=lambda each: each.real)
        raise ValueError(f"the system is unstable at Delta = 0, its nominal values: a pole at {abs(pole):.4g} rad/s")


def _sweep(M: Lti, blocks: tuple[DeltaBlock, ...], *, gain: bool, accuracy: float) -> tuple[float, list[float]]:
    """Return the level and the frequencies of `sweep` for a balanced system."""
    pending, slow, fast = _first_frequencies(M)
    gaps, met = [(0.0, math.inf)], list[tuple[float, float]]()
    level = 1e-3 * accuracy * (_nominal_peak(M, blocks) if gain else hinf_norm(M)).gain
    for count in range(_BANDS):
        omega = pending.pop(0) if pending else _pick_frequency(gaps[0], slow, fast)
        response = M.response(omega)[0]
        # find the best scalings, beyond the level: scalings that only just reach it hold on a narrow band
        scalings = best_scalings(response, blocks, gain=gain, accuracy=0.5 * accuracy, enough=_DEEP * level)
        gap, reached = gaps[0], scalings.level(response)
        raised = max(level, (1.0 + 0.5 * accuracy) * reached)
        if _is_narrow(gap) and math.isfinite(reached):
            band = scalings.band(M, raised / (1.0 + _ROUNDING), omega)
            if not band[0] <= gap[0] <= gap[1] <= band[1]:
                scalings = best_scalings(response, blocks, gain=gain, accuracy=0.5 * accuracy, real=False)
                reached = scalings.level(response)
        met.append((reached, omega))
        if not math.isfinite(reached):
            return math.inf, _largest_frequencies(met)
        level = max(level, (1.0 + 0.5 * accuracy) * reached)
        bands = [scalings.band(M, level / (1.0 + _ROUNDING), omega)]
        if count >= _PATIENCE and reached < _FAR_BELOW * level:
            bands += _bands_of_modest_scalings(M, blocks, level, omega, gain)
        gaps = _subtract_band(gaps, max(bands, key=_width))
        if not gaps:
            return level, _largest_frequencies(met)
    return math.inf, _largest_frequencies(met)


def _prove(
    M: Lti, blocks: tuple[DeltaBlock, ...], *, gain: bool, accuracy: float, level: float
) -> tuple[float, list[float]]:
    """Return the `level` if scalings prove it at every frequency, else infinity, and frequencies as `_sweep`."""
    pending, slow, fast = _first_frequencies(M)
    gaps, met, reached = [(0.0, math.inf)], list[tuple[float, float]](), 0.0
    if gain:
        peak = _nominal_peak(M, blocks)
        met, reached = [(peak.gain, min(peak.omega, 1e3 * fast))], peak.gain
    while gaps and reached < level and len(met) < _BANDS:
        omega = pending.pop(0) if pending else _pick_frequency(gaps[0], slow, fast)
        response, narrow = M.response(omega)[0], _is_narrow(gaps[0])
        scalings = best_scalings(response, blocks, gain=gain, accuracy=_COARSE, enough=_DEEP * level, real=not narrow)
        if not scalings.level(response) < level:
            scalings = best_scalings(response, blocks, gain=gain, accuracy=0.5 * accuracy)
        reached = scalings.level(response)
        met.append((reached, omega))
        bands = [scalings.band(M, level / (1.0 + _ROUNDING), omega)]
        if len(met) > _PATIENCE and reached < _FAR_BELOW * level:
            bands += _bands_of_modest_scalings(M, blocks, level, omega, gain)
        gaps = _subtract_band(gaps, max(bands, key=_width))
    return math.inf if gaps else level, _largest_frequencies(met)


def _first_frequencies(M: Lti) -> tuple[list[float], float, float]:
    """Return the frequencies to try first [rad/s], and those of the slowest and of the fastest pole."""
    speeds = np.abs(M.poles())
    slow, fast = float(np.min(speeds, initial=1.0)), float(np.max(speeds, initial=1.0))
    peak = min(hinf_norm(M).omega, 1e3 * fast)
    return [0.0, peak, 1e3 * fast, *np.geomspace(slow, fast, 5).tolist()], slow, fast


def _nominal_peak(M: Lti, blocks: tuple[DeltaBlock, ...]) -> Peak:
    """Return the gain of the last block's channels at Delta = 0, a lower bound."""
    z, w = columns(blocks)[-1].start, rows(blocks)[-1].start
    return hinf_norm(M.subsystem(slice(z, None), slice(w, None)))


def _bands_of_modest_scalings(
    M: Lti, blocks: tuple[DeltaBlock, ...], level: float, omega: float, gain: bool
) -> list[tuple[float, float]]:
    """Return bands of scalings that just reach a level: the best ones hold on narrow bands where mu is near 0."""
    response = M.response(omega)[0]
    modest = best_scalings(response, blocks, gain=gain, accuracy=0.1, real=False)
    midway = best_scalings(response, blocks, gain=gain, accuracy=0.1, enough=_FAR_BELOW * level)
    return [each.band(M, level / (1.0 + _ROUNDING), omega) for each in (modest, midway)]


def add_performance_block(system: Uncertain) -> tuple[DeltaBlock, ...]:
    """Return the blocks of a system, then the full block that closes its inputs and outputs."""
    return (*system.blocks, FullBlock(name=PERFORMANCE, n_outputs=system.n_inputs, n_inputs=system.n_outputs))


def to_continuous(system: Uncertain) -> Lti:
    """Return `M` in continuous time and balanced units; a discrete one by the bilinear transform.

    Every bound stays: external channels keep their units, and a Delta is the same in those of its channels.
    """
    M = balance_states(system.M)
    continuous = bilinear_transform(M) if M.dt else M
    if not continuous.is_stable():  # where a pole is on the axis there is no response to balance by
        return continuous
    return balance(continuous, system.blocks).change(continuous)


def unwarp_frequency(omega: float, system: Uncertain) -> float:
    """Return the system's frequency [rad/s] that the bilinear transform maps to `omega`."""
    dt = system.M.dt
    return 2.0 / dt * math.atan(0.5 * omega * dt) if dt else omega


def _pick_frequency(gap: tuple[float, float], slow: float, fast: float) -> float:
    """Return the frequency inside a gap to try next."""
    low, high = gap
    if math.isinf(high):
        return 4.0 * max(low, fast)
    return math.sqrt(low * high) if low > 0.0 else min(0.1 * high, slow)


def _is_narrow(gap: tuple[float, float]) -> bool:
    return gap[1] < (1.0 + _MIN_GAP) * gap[0]


def _width(band: tuple[float, float]) -> float:
    return band[1] - band[0]


def _subtract_band(gaps: list[tuple[float, float]], band: tuple[float, float]) -> list[tuple[float, float]]:
    """Return the gaps without the band."""
    if band[0] >= band[1]:
        return gaps
    pieces = [piece for low, high in gaps for piece in ((low, min(high, band[0])), (max(low, band[1]), high))]
    return [(low, high) for low, high in pieces if low < high]


def _largest_frequencies(met: list[tuple[float, float]]) -> list[float]:
    return [omega for _, omega in sorted(met, reverse=True)[:4]]
