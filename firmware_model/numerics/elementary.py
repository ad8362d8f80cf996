"""Elementary functions and random numbers that give the same bits on every route.

A call into the C library inside a loop over flights keeps the compiler from SIMD, and its result differs between
machines. These functions are polynomials and integer arithmetic: without branches inside hot loops, and repeatable to
the bit.
"""

import math

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.packing import is_outside, list_outside

Array = NDArray[np.float64]
BLOCK = 32
"""Length of the inner loop of `inverse_normals`, constant so that the compiler finds SIMD."""

# pi/2 in three parts, each but the last with trailing zeros, so that n * part is exact for |n| < 2^20
# (W. J. Cody and W. Waite, Software Manual for the Elementary Functions, 1980; parts as in Sun's fdlibm e_rem_pio2.c).
_PIO2_1 = 1.57079632673412561417e00
_PIO2_2 = 6.07710050630396597660e-11
_PIO2_3 = 2.02226624879595063154e-21

Word = np.uint64
"""A number below 2^32, held in 64 bits so that products fit."""
Words = tuple[Word, Word, Word, Word]

Eight = tuple[float, float, float, float, float, float, float, float]


def _eight(text: str) -> Eight:
    a, b, c, d, e, f, g, h = map(float, text.split())
    return a, b, c, d, e, f, g, h


# Numerators and denominators of Wichura's quantile and the logarithm's series, from the lowest power on.
_CENTRAL_N = _eight(
    "3.3871328727963666080e0 1.3314166789178437745e2 1.9715909503065514427e3 1.3731693765509461125e4 "
    "4.5921953931549871457e4 6.7265770927008700853e4 3.3430575583588128105e4 2.5090809287301226727e3"
)
_CENTRAL_D = _eight(
    "1.0 4.2313330701600911252e1 6.8718700749205790830e2 5.3941960214247511077e3 "
    "2.1213794301586595867e4 3.9307895800092710610e4 2.8729085735721942674e4 5.2264952788528545610e3"
)
_LOG = _eight(
    "6.666666666666735130e-01 3.999999999940941908e-01 2.857142874366239149e-01 2.222219843214978396e-01 "
    "1.818357216161805012e-01 1.531383769920937332e-01 1.479819860511658591e-01 0.0"
)
_TAIL_N = _eight(
    "1.42343711074968357734e0 4.63033784615654529590e0 5.76949722146069140550e0 3.64784832476320460504e0 "
    "1.27045825245236838258e0 2.41780725177450611770e-1 2.27238449892691845833e-2 7.74545014278341407640e-4"
)
_TAIL_D = _eight(
    "1.0 2.05319162663775882187e0 1.67638483018380384940e0 6.89767334985100004550e-1 "
    "1.48103976427480074590e-1 1.51986665636164571966e-2 5.47593808499534494600e-4 1.05075007164441684324e-9"
)

_U32 = np.uint64(0xFFFFFFFF)
_32 = np.uint64(32)
# The tails are outside 0.075..0.925, told by the bits, which grow with a positive number: the fastest test.
_LEAST = int(np.float64(0.075).view(np.int64))
_BREADTH = int(np.float64(0.925).view(np.int64)) - _LEAST


@kernel
def sin_cos(x: float) -> tuple[float, float]:
    """Return sine and cosine of `x` [rad] within 1 ulp of 1, for `|x|` up to 1e5.

    References
    ----------
    Sun Microsystems, fdlibm, k_sin.c and k_cos.c (minimax coefficients).
    """
    n = math.floor(x * (2.0 / math.pi) + 0.5)
    r = ((x - n * _PIO2_1) - n * _PIO2_2) - n * _PIO2_3
    z = r * r
    s = (1.58969099521155010221e-10 * z - 2.50507602534068634195e-08) * z + 2.75573137070700676789e-06
    s = (s * z - 1.98412698298579493134e-04) * z + 8.33333333332248946124e-03
    s = r + r * z * (s * z - 1.66666666666666324348e-01)
    c = (2.08757232129817482790e-09 - 1.13596475577881948265e-11 * z) * z - 2.75573143513906633035e-07
    c = (c * z + 2.48015872894767294178e-05) * z - 1.38888888888741095749e-03
    c = 1.0 - 0.5 * z + z * z * (c * z + 4.16666666666666019037e-02)
    quadrant = n - 4.0 * math.floor(0.25 * n)
    odd = quadrant == 1.0 or quadrant == 3.0
    sine = c if odd else s
    cosine = s if odd else c
    return (-sine if quadrant >= 2.0 else sine), (-cosine if quadrant == 1.0 or quadrant == 2.0 else cosine)


@kernel
def arctan2(y: float, x: float) -> float:
    """Return the angle of (`x`, `y`) in [-pi, pi] [rad], within 2 ulp of pi; 0 where both are 0.

    References
    ----------
    S. L. Moshier, Cephes, atan.c (rational approximation on |t| <= 0.66).
    """
    larger = max(abs(x), abs(y))
    smaller = min(abs(x), abs(y))
    upper = smaller > 0.66 * larger
    # arctan(r) = pi/4 + arctan((r - 1) / (r + 1)), with the ratio r as numerator and denominator: one division.
    t = (smaller - larger if upper else smaller) / (smaller + larger if upper else (larger if larger > 0.0 else 1.0))
    z = t * t
    p = (-8.750608600031904122785e-1 * z - 1.615753718733365076637e1) * z - 7.500855792314704667340e1
    p = (p * z - 1.228866684490136173410e2) * z - 6.485021904942025371773e1
    q = ((z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2) * z + 4.328810604912902668951e2
    q = (q * z + 4.853903996359136964868e2) * z + 1.945506571482613964425e2
    angle = t + t * z * p / q + (0.25 * math.pi if upper else 0.0)
    angle = 0.5 * math.pi - angle if abs(y) > abs(x) else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@kernel
def log(x: float) -> float:
    """Return the natural logarithm of a normal positive number within 1 ulp.

    References
    ----------
    Sun Microsystems, fdlibm, e_log.c (minimax coefficients).
    """
    bits = np.float64(x).view(np.int64)
    # Exponent and mantissa such that the mantissa lies in [sqrt(1/2), sqrt(2)).
    k = (bits - np.int64(0x3FE6A09E667F3BCD)) >> np.int64(52)
    f = np.int64(bits - (k << np.int64(52))).view(np.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    r = z * _octave(z, _LOG)
    half = 0.5 * f * f
    return k * 6.93147180369123816490e-01 - ((half - (s * (half + r) + k * 1.90821492927058770002e-10)) - f)


@kernel
def inverse_normal(u: float) -> float:
    """Return the standard normal quantile of `u` in [1e-10, 1 - 1e-10], relative error below 1e-15.

    References
    ----------
    M. J. Wichura, Algorithm AS 241: The percentage points of the normal distribution, Applied Statistics 37, 1988,
    PPND16, without its far tail, which 32-bit uniforms never reach.
    """
    return _tail_quantile(_tail_root(u)) if is_outside(u, _LEAST, _BREADTH) else _central_quantile(u)


@kernel
def inverse_normals(u: Array, tail: Array, indices: NDArray[np.int32]) -> None:
    """Write the `inverse_normal` of each number in `u` in its place.

    `indices` is scratch of the size of `u`, `tail` is `BLOCK` longer. One number in seven lies in the tails. Those are
    packed side by side, because SIMD that followed both paths for every number would take twice the time. Their roots
    have a loop of their own: a processor looks ahead too little to overlap chains as long as both together.
    """
    count = list_outside(u, _LEAST, _BREADTH, indices)
    for i in range(count):
        tail[i] = u[indices[i]]
    for i in range(BLOCK):
        tail[count + i] = 0.5
    for i in range(u.size):
        u[i] = _central_quantile(u[i])
    for start in range(0, count, BLOCK):
        for i in range(start, start + BLOCK):
            tail[i] = _tail_root(tail[i])
    for start in range(0, count, BLOCK):
        for i in range(start, start + BLOCK):
            tail[i] = _tail_quantile(tail[i])
    for i in range(count):
        u[indices[i]] = tail[i]


@kernel
def _octave(x: float, a: Eight) -> float:
    """Return `a[0] + a[1] x + ... + a[7] x^7`, by Estrin's scheme.

    Horner's scheme takes two products less, but each waits for the one before. A processor looks ahead for some hundred
    operations only, and then waits too.
    """
    y = x * x
    low, high = (a[0] + a[1] * x) + (a[2] + a[3] * x) * y, (a[4] + a[5] * x) + (a[6] + a[7] * x) * y
    return low + high * (y * y)


@kernel
def _central_quantile(u: float) -> float:
    q = u - 0.5
    r = 0.180625 - q * q
    return q * _octave(r, _CENTRAL_N) / _octave(r, _CENTRAL_D)


@kernel
def _tail_root(u: float) -> float:
    """Return the variable of `_tail_quantile` for a number in the tails, with the sign of its quantile."""
    t = math.sqrt(-log(min(u, 1.0 - u))) - 1.6
    return -t if u < 0.5 else t


@kernel
def _tail_quantile(root: float) -> float:
    t = abs(root)
    tail = _octave(t, _TAIL_N) / _octave(t, _TAIL_D)
    return -tail if root < 0.0 else tail


@kernel
def philox(counter: Words, key: tuple[Word, Word]) -> Words:
    """Return four 32-bit random integers, a pure function of `counter` and `key`.

    References
    ----------
    J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, Parallel random numbers: as easy as 1, 2, 3, SC11, 2011:
    Philox4x32-10.
    """
    a, b, c, d = counter
    j, k = key
    for _ in range(10):
        low = np.uint64(0xD2511F53) * a
        high = np.uint64(0xCD9E8D57) * c
        a, b, c, d = (high >> _32) ^ b ^ j, high & _U32, (low >> _32) ^ d ^ k, low & _U32
        j = (j + np.uint64(0x9E3779B9)) & _U32
        k = (k + np.uint64(0xBB67AE85)) & _U32
    return a, b, c, d


@kernel
def uniforms(seed: int, stream: int, sample: int, block: int) -> tuple[float, float, float, float]:
    """Return four independent numbers, uniform in (0, 1), of one block of one sample of a stream under a seed.

    A pure function of its arguments: no flight, sensor or step changes the numbers of another. Each argument is below
    2^32. The numbers lie on a grid of 2^32 steps.
    """
    counter = (np.uint64(sample), np.uint64(block), np.uint64(0), np.uint64(0))
    a, b, c, d = philox(counter, (np.uint64(seed), np.uint64(stream)))
    return _uniform(a), _uniform(b), _uniform(c), _uniform(d)


@kernel
def _uniform(word: Word) -> float:
    return (np.float64(word) + 0.5) * 2.0**-32


@kernel
def normals(seed: int, stream: int, sample: int, block: int) -> tuple[float, float, float, float]:
    """Return four standard normal numbers made of `uniforms`; `|n|` stays below 6.34."""
    a, b, c, d = uniforms(seed, stream, sample, block)
    return inverse_normal(a), inverse_normal(b), inverse_normal(c), inverse_normal(d)


@kernel
def mixed_normals(mix: Array, stream: int, sample: int, block: int) -> tuple[float, float, float, float]:
    """Return four standard normal numbers, sums of the `normals` of several seeds.

    Each row of `mix` (n, 3) holds a seed and two factors [-]: on the sum of the rows before it, and on the normals of
    its seed. The squares of the factors add up to 1. The first row is (seed, 0, 1).
    """
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for j in range(mix.shape[0]):
        kept, added = mix[j, 1], mix[j, 2]
        e, f, g, h = normals(int(mix[j, 0]), stream, sample, block)
        a, b, c, d = kept * a + added * e, kept * b + added * f, kept * c + added * g, kept * d + added * h
    return a, b, c, d
