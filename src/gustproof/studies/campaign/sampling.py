"""Normalised deltas in [-1, 1] of a campaign's cases, each a pure function of seed and case.

Any range of cases can be drawn alone, at a cost independent of its position. Memory does not grow with the campaign.
"""

import warnings
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from gustproof.types import Array

Words = NDArray[np.uint64]

_EDGE_SIGMAS = 3.0  # standard deviations from nominal to edge, where the normal distribution is truncated
_SOBOL_SEED, _CASES, _STRATA = 4, 5, 6  # streams of random numbers; a flight uses 1 to 3
_ROUNDS = 6
_LEAST = 2.0**-53  # a uniform number of 0 has no quantile


class Sampling(Enum):
    """Sampling method of the deltas.

    Examples
    --------
    >>> from gustproof import Sampling
    >>> [kind.value for kind in Sampling]
    ['uniform', 'normal', 'latin', 'sobol']
    """

    UNIFORM = "uniform"  # independent, uniform on [-1, 1]
    NORMAL = "normal"  # independent, normal with a standard deviation of 1/3, truncated at the edges
    LATIN = "latin"  # latin hypercube: of n cases, one in each n-th of each dispersion's range
    SOBOL = "sobol"  # scrambled Sobol' points: even in all dispersions at once, best with 2^k cases


def draw_deltas(sampling: Sampling, seed: int, cases: int, width: int, first: int, count: int) -> Array:
    """Return the deltas (count, width) of the cases from `first` on, out of `cases`."""
    match sampling:
        case Sampling.SOBOL:
            fractions = _draw_sobol(seed, width, first, count)
        case Sampling.LATIN:
            inside = _draw_uniform(seed, width, first, count)
            strata = np.arange(first, first + count, dtype=np.uint64)
            columns = [permute(strata, cases, _key(seed, _STRATA, column)) for column in range(width)]
            fractions = (np.array(columns, dtype=np.float64).reshape(width, count).T + inside) / cases
        case _:
            fractions = _draw_uniform(seed, width, first, count)
    return _to_normal(fractions) if sampling is Sampling.NORMAL else 2.0 * fractions - 1.0


def draw_normals(seed: int, width: int, first: int, count: int) -> Array:
    """Return standard normal numbers (count, width) of the cases from `first` on, each a dispersion's place."""
    from scipy.special import ndtri

    places: Array = ndtri(np.clip(_draw_uniform(seed, width, first, count), _LEAST, 1.0 - _LEAST))
    return places


def place_deltas(sampling: Sampling, normals: Array) -> Array:
    """Return the deltas (n,) of an independent case at the standard normal `normals` (n,)."""
    from scipy.special import ndtr

    fractions: Array = ndtr(normals)
    return _to_normal(fractions) if sampling is Sampling.NORMAL else 2.0 * fractions - 1.0


def flight_seeds(seed: int, first: int, count: int) -> list[int]:
    """Return the seeds of gusts and noise of the cases from `first` on, in [0, 2^32), distinct within a campaign."""
    begin = int(_key(seed, _CASES, 0)[0])
    return [(begin + case) % 2**32 for case in range(first, first + count)]


def permute(numbers: Words, n: int, key: Words) -> Words:
    """Return the images of `numbers` under a pseudo-random permutation of 0 .. n-1.

    The permutation is a Feistel network on the bits of n - 1, or one bit more; results of n or more pass through again.

    References
    ----------
    J. Black, P. Rogaway, Ciphers with Arbitrary Finite Domains, CT-RSA 2002: cycle-walking, and the network.
    """
    half = np.uint64(max((n - 1).bit_length() + 1, 2) // 2)
    placed = _feistel(numbers, half, key)
    while (outside := placed >= n).any():
        placed[outside] = _feistel(placed[outside], half, key)
    return placed


def _feistel(numbers: Words, half: np.uint64, key: Words) -> Words:
    mask = (np.uint64(1) << half) - np.uint64(1)
    left, right = numbers >> half, numbers & mask
    for k in range(_ROUNDS):
        mixed = (right + key[k]) * np.uint64(0x9E3779B97F4A7C15)  # wraps at 2^64
        mixed ^= mixed >> np.uint64(29)
        mixed *= np.uint64(0xBF58476D1CE4E5B9)
        left, right = right, left ^ ((mixed >> np.uint64(32)) & mask)
    shuffled: Words = (left << half) | right
    return shuffled


def _draw_uniform(seed: int, width: int, first: int, count: int) -> Array:
    """Return numbers in [0, 1), (count, width); each case has a fixed position in one counter-based stream."""
    blocks = -(-width // 4)  # the generator gives four numbers per count
    generator = np.random.Philox(key=_key(seed, _CASES, width)[:2])
    generator.advance(first * blocks)
    return np.random.Generator(generator).random((count, 4 * blocks))[:, :width]


def _draw_sobol(seed: int, width: int, first: int, count: int) -> Array:
    from scipy.stats.qmc import Sobol

    points = Sobol(width, scramble=True, rng=np.random.default_rng(np.random.SeedSequence([seed, _SOBOL_SEED])))
    if first:
        points.fast_forward(first)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The balance properties")  # it checks one chunk, not all cases
        drawn: Array = points.random(count)
    return drawn


def _to_normal(fractions: Array) -> Array:
    from scipy.special import ndtr, ndtri

    tail = ndtr(-_EDGE_SIGMAS)
    quantiles: Array = ndtri(tail + fractions * (1.0 - 2.0 * tail)) / _EDGE_SIGMAS
    return np.clip(quantiles, -1.0, 1.0)


def _key(seed: int, stream: int, part: int) -> Words:
    key: Words = np.random.SeedSequence([seed, stream, part]).generate_state(_ROUNDS, np.uint64).astype(np.uint64)
    return key
