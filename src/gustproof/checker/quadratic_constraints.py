"""Integral quadratic constraints on the parts of a loop, in rational numbers: parameters, delays, sectors, slopes.

Part of the check: rational arithmetic only. A part takes q to p, `size` channels each. Its filter, started at rest, has
the states f of `f' = A f + B (q, p)`. The integral of the constraint's form over all time is not negative, whatever
the part does, for every square integrable q. The same holds of the part times any factor from 0 to 1, so that the
theorem of Megretski and Rantzer joins parts to a stable loop.

References
----------
A. Megretski, A. Rantzer, System analysis via integral quadratic constraints, IEEE TAC 42 (1997), 819-830 (theorem 1;
the list of section VI). G. Zames, P. L. Falb, Stability conditions for systems with monotone and slope-restricted
nonlinearities, SIAM J. Control 6 (1968), 89-108. C.-Y. Kao, B. Lincoln, Simple stability criteria for systems with
time-varying delays, Automatica 40 (2004), 1429-1434.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import NamedTuple

from gustproof.checker.evidence_types import BlockTable, Matrix, MultiplierTable, PartTable
from gustproof.checker.rational import (
    RationalMatrix,
    add,
    identity,
    is_positive_definite,
    multiply,
    scale,
    to_rational,
    transpose,
    zeros,
)
from gustproof.checker.system import Refusal, finite

LEAD, LAG = Fraction(1414, 10000), Fraction(6425, 10000)
"""Coefficients c and b of `W(s) = s (1 + 2 c s) / (1 + b s + c s^2)`, which covers the delays of up to 1 s. For
all frequencies |W| is at least |exp(-j omega theta) - 1|, theta in [0, 1]."""


class ConstraintFilter(NamedTuple):
    """Filter of a part's constraint."""

    A: RationalMatrix
    """(f, f) of its states; no rows without any."""
    B: RationalMatrix
    """(f, 2 size) of (q, p)."""


def kind_of(block: PartTable) -> str:
    """Return the kind of a part; a block without one is a real parameter."""
    return str(block.get("kind", "real"))


def needs_rate(block: BlockTable) -> bool:
    """Return whether the constraint is of q' too, so that q must not jump."""
    return kind_of(block) == "varying delay"


def make_filter(block: BlockTable) -> ConstraintFilter:
    """Return the filter of a part.

    Raises
    ------
    Refusal
        If the part has a delay or poles that are not positive.
    """
    kind, size = kind_of(block), block["size"]
    poles = [_positive("a pole", block, pole) for pole in block.get("poles", ())]
    if "largest" in block:
        _positive("the delay", block, block["largest"])
    if kind == "delay":
        return _delay_filter(Fraction(block["largest"]), poles, size)
    if kind == "slope":
        return _slope_filter(poles, size)
    return ConstraintFilter([], [])


def count_states(block: BlockTable) -> int:
    """Return the number of states of a part's filter."""
    poles = len(block.get("poles", ()))
    return int(block["size"]) * {"delay": 2 + 3 * poles, "slope": 2 * poles}.get(kind_of(block), 0)


def check_sizes(block: BlockTable) -> None:
    """Raise `Refusal` unless the multipliers of a part have the size of its channels and poles."""
    kind, size, poles = kind_of(block), block["size"], len(block.get("poles", ()))
    if kind not in _KINDS:
        raise Refusal(f"block {block['name']} is of unknown kind '{kind}'")
    if set(block) != {"name", "size", *_KINDS[kind].entries}:
        raise Refusal(f"block {block['name']} has other entries than one of kind '{kind}'")
    wide = size * (1 + poles)
    rows = {"D": size, "G": size, "X": wide, "Y": wide, "T": size, "causal": poles, "anticausal": poles}
    for name, value in block.items():
        if name in rows and not (isinstance(value, list) and len(value) == rows[name]):
            raise Refusal(f"{name} of block {block['name']} does not have its size")


def check_multipliers(block: BlockTable, multipliers: MultiplierTable) -> None:
    """Raise `Refusal` for numbers with which the form is no constraint of the part."""
    _KINDS[kind_of(block)].check(block, multipliers)


def constraint_form(block: BlockTable, multipliers: MultiplierTable) -> RationalMatrix:
    """Return the symmetric form in (f, q, p), then q' if the constraint needs it; linear in the multipliers."""
    return _KINDS[kind_of(block)].form(block, multipliers)


def _positive(what: str, block: BlockTable, value: object) -> Fraction:
    number = finite(what, value)
    if number <= 0:
        raise Refusal(f"{what} of block {block['name']} is not positive")
    return number


def _delay_filter(largest: Fraction, poles: Sequence[Fraction], size: int) -> ConstraintFilter:
    """Return the filter of `_delay_form`: two states of W, then F W q, F q and F p of each pole; by channels within."""
    count = 2 + 3 * len(poles)
    A, from_q, from_p = zeros(count, count), [Fraction(0)] * count, [Fraction(0)] * count
    A[0][1] = 1 / largest
    A[1][0], A[1][1], from_q[1] = -1 / (LEAD * largest), -LAG / (LEAD * largest), 1 / (LEAD * largest)
    for k, pole in enumerate(poles):
        covered, plain, delayed = (2 + 3 * k + i for i in range(3))
        for state in (covered, plain, delayed):
            A[state][state] = -pole
        A[covered][0], A[covered][1], from_q[covered] = -2 * pole, (1 - 2 * LAG) * pole, 2 * pole
        from_q[plain] = from_p[delayed] = pole
    return _repeat(A, from_q, from_p, size)


def _slope_filter(poles: Sequence[Fraction], size: int) -> ConstraintFilter:
    """Return the filter of `_slope_form`: F (q - p) and F p of each pole, by channels within."""
    count = 2 * len(poles)
    A, from_q, from_p = zeros(count, count), [Fraction(0)] * count, [Fraction(0)] * count
    for k, pole in enumerate(poles):
        A[2 * k][2 * k] = A[2 * k + 1][2 * k + 1] = -pole
        from_q[2 * k], from_p[2 * k], from_p[2 * k + 1] = pole, -pole, pole
    return _repeat(A, from_q, from_p, size)


def _repeat(A: RationalMatrix, from_q: list[Fraction], from_p: list[Fraction], size: int) -> ConstraintFilter:
    """Return the filter of one channel for each of `size` channels."""
    unit = identity(size)
    columns = [[value] for value in from_q], [[value] for value in from_p]
    of_q, of_p = (_kron(column, unit) for column in columns)
    return ConstraintFilter(_kron(A, unit), [a + b for a, b in zip(of_q, of_p, strict=True)])


def _kron(A: RationalMatrix, B: RationalMatrix) -> RationalMatrix:
    return [[a * b for a in row for b in other] for row in A for other in B]


def _congruence(rows: RationalMatrix, M: RationalMatrix) -> RationalMatrix:
    return multiply(transpose(rows), multiply(M, rows))


def _cross(left: RationalMatrix, M: RationalMatrix, right: RationalMatrix) -> RationalMatrix:
    half = multiply(transpose(left), multiply(M, right))
    return add(half, transpose(half))


def _check_definite(block: BlockTable, name: str, rows: Matrix, size: int) -> None:
    matrix = to_rational(rows)
    if len(matrix) != size:
        raise Refusal(f"{name} of block {block['name']} does not have its size")
    if not is_positive_definite(matrix):
        raise Refusal(f"{name} of block {block['name']} is not positive definite")


def _check_real(block: BlockTable, multipliers: MultiplierTable) -> None:
    D, G = to_rational(multipliers["D"]), to_rational(multipliers["G"])
    if not len(D) == len(G) == block["size"]:
        raise Refusal(f"the scalings of block {block['name']} do not have its size")
    _check_definite(block, "D", D, block["size"])
    if transpose(G) != scale(-1, G):
        raise Refusal(f"G of block {block['name']} is not skew")


def _real_form(_: BlockTable, multipliers: MultiplierTable) -> RationalMatrix:
    """Return the form of `p = delta q`, |delta| <= 1 at any speed: q'D q - p'D p + 2 q'G p, D > 0 and G skew."""
    D, G = to_rational(multipliers["D"]), to_rational(multipliers["G"])
    upper = [a + b for a, b in zip(D, G, strict=True)]
    return upper + [a + b for a, b in zip(transpose(G), scale(-1, D), strict=True)]


def _check_delay(block: BlockTable, multipliers: MultiplierTable) -> None:
    for name in ("X", "Y"):
        _check_definite(block, name, multipliers[name], block["size"] * (1 + len(block["poles"])))


def _delay_form(block: BlockTable, multipliers: MultiplierTable) -> RationalMatrix:
    """Return the form of `p(t) = q(t - theta) - q(t)`, theta constant in [0, largest] and the same for all channels.

    With F = a / (s + a) for each pole a and H = (1, F...), X and Y positive definite:

        (H W q)' X (H W q) - (H p)' X (H p) - (H p)' Y (H p) - 2 (H p)' Y (H q).

    By frequency, p = d q with |d| <= |W(j omega largest)| and |d + 1| <= 1; factors below 1 keep both.
    """
    size, poles = block["size"], len(block["poles"])
    states = 2 + 3 * poles
    unit = identity(states + 2)
    W = [[-2 * a + (1 - 2 * LAG) * b + 2 * c for a, b, c in zip(unit[0], unit[1], unit[states], strict=True)]]
    one = identity(size)
    covered, plain, delayed = (
        _kron([*first, *(unit[2 + 3 * k + i] for k in range(poles))], one)
        for i, first in enumerate((W, [unit[states]], [unit[states + 1]]))
    )
    X, Y = to_rational(multipliers["X"]), to_rational(multipliers["Y"])
    return add(
        _congruence(covered, X),
        scale(-1, _congruence(delayed, add(X, Y))),
        scale(-1, _cross(delayed, Y, plain)),
    )


def _check_varying(block: BlockTable, multipliers: MultiplierTable) -> None:
    _check_definite(block, "X", multipliers["X"], block["size"])


def _varying_form(block: BlockTable, multipliers: MultiplierTable) -> RationalMatrix:
    """Return the form of a delay that changes at will within [0, largest]: largest^2 q''X q' - p'X p in (q, p, q').

    p is minus the integral of q' over a time of at most `largest`: by Cauchy and Schwarz its norm is at most `largest`
    times that of q'. A command held between samples is of this kind.
    """
    size = block["size"]
    X, largest = to_rational(multipliers["X"]), Fraction(block["largest"])
    unit = identity(3 * size)
    held, rate = unit[size : 2 * size], unit[2 * size :]
    return add(scale(largest * largest, _congruence(rate, X)), scale(-1, _congruence(held, X)))


def _check_sector(block: BlockTable, multipliers: MultiplierTable) -> None:
    for value in multipliers["T"]:
        _positive("T", block, value)


def _sector_form(block: BlockTable, multipliers: MultiplierTable) -> RationalMatrix:
    """Return the form of `p_i = phi_i(q_i, t)` between 0 and q_i: 2 p'T (q - p), T diagonal and positive."""
    size = block["size"]
    unit = identity(2 * size)
    return _cross(unit[size:], _diagonal(multipliers["T"]), _subtract(unit[:size], unit[size:]))


def _check_slope(block: BlockTable, multipliers: MultiplierTable) -> None:
    _check_sector(block, multipliers)
    if not isinstance(block["odd"], bool):
        raise Refusal(f"block {block['name']} is neither odd nor not: 'odd' must be true or false")
    taken = [Fraction(0)] * block["size"]
    for name in ("causal", "anticausal"):
        rows = _read_impulses(block, name, multipliers[name])
        taken = [sum(map(abs, column), start) for start, *column in zip(taken, *rows, strict=True)]
    if any(used > Fraction(whole) for used, whole in zip(taken, multipliers["T"], strict=True)):
        raise Refusal(f"the multiplier of block {block['name']} is larger than the slope allows")


def _read_impulses(block: BlockTable, name: str, values: Matrix) -> RationalMatrix:
    """Return the multipliers of the impulse responses, by poles and channels."""
    rows = to_rational(values)
    if len(rows) != len(block["poles"]) or any(len(row) != block["size"] for row in rows):
        raise Refusal(f"{name} of block {block['name']} does not have the size of poles and channels")
    if not block["odd"] and any(value < 0 for row in rows for value in row):
        raise Refusal(f"{name} of block {block['name']} is negative, which only an odd function allows")
    return rows


def _slope_form(block: BlockTable, multipliers: MultiplierTable) -> RationalMatrix:
    """Return the form of Zames and Falb for `p_i = phi_i(q_i)`, slopes in [0, 1], with e = q - p.

    With F = a / (s + a) for each pole, by channel:

        2 (T p e - sum c p (F e) - sum d e (F p)), sum |c| + |d| <= T.

    The impulse response of F is positive and its integral 1, so that T less the two sums is a multiplier of theirs.
    """
    size, poles = block["size"], len(block["poles"])
    unit = identity(2 * poles * size + 2 * size)
    q, p = unit[-2 * size : len(unit) - size], unit[-size:]
    e = _subtract(q, p)
    terms = [_cross(p, _diagonal(multipliers["T"]), e)]
    for k in range(poles):
        late_e, late_p = (unit[(2 * k + i) * size : (2 * k + i + 1) * size] for i in range(2))
        terms.append(scale(-1, _cross(p, _diagonal(multipliers["causal"][k]), late_e)))
        terms.append(scale(-1, _cross(e, _diagonal(multipliers["anticausal"][k]), late_p)))
    return add(*terms)


def _diagonal(values: Sequence[float | Fraction]) -> RationalMatrix:
    return [[Fraction(value) if i == j else Fraction(0) for j in range(len(values))] for i, value in enumerate(values)]


def _subtract(A: RationalMatrix, B: RationalMatrix) -> RationalMatrix:
    return add(A, scale(-1, B))


class _Kind(NamedTuple):
    entries: tuple[str, ...]
    """Entries of a block beside name and size."""
    check: Callable[[BlockTable, MultiplierTable], None]
    form: Callable[[BlockTable, MultiplierTable], RationalMatrix]


_KINDS = {
    "real": _Kind(("D", "G"), _check_real, _real_form),
    "delay": _Kind(("kind", "largest", "poles", "X", "Y"), _check_delay, _delay_form),
    "varying delay": _Kind(("kind", "largest", "X"), _check_varying, _varying_form),
    "sector": _Kind(("kind", "T"), _check_sector, _sector_form),
    "slope": _Kind(("kind", "odd", "poles", "T", "causal", "anticausal"), _check_slope, _slope_form),
}
"""Entries, conditions and form of each kind of part."""
