"""Worst-case operations of a step in generated C, counted in its text.

The text has no recursion, no unbounded loop, and no branch but choices between values and early returns. So each
operator counts once for each time that its function is called or its loop runs; both sides of a choice count. The sum
is reached or overcounted.
"""

import re

_FUNCTION = re.compile(r"^(?:static )?\w+ (\w+)\([^;{]*\)\n\{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
_LOOP = re.compile(r"for \(int \w+ = 0; \w+ < (\d+); \w+\+\+\)(?: \{(.*?)\n\s*\}|\s*([^;]*;))", re.DOTALL)
_ARITHMETIC = re.compile(r"[-+*/<>?]|=(?!=)")
"""Sums, products, quotients, comparisons, choices and assignments; signs and dereferences count too."""
INSTRUCTIONS = 2
"""[-] bound of machine instructions per operation, by GCC at -O2 on x86-64 and on ARM with an FPU; tests count."""


def count_operations(source: str, function: str) -> int:
    r"""Return a bound of the operations of a call of `function` in generated C, with all that it calls.

    Examples
    --------
    >>> count_operations("static int f(int a)\\n{\\n    return a * a + 1;\\n}\\n", "f")
    2
    """
    text = re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL)
    bodies = {name: body for name, body in _FUNCTION.findall(text)}
    return _count(bodies[function], bodies)


def _count(body: str, bodies: dict[str, str]) -> int:
    total = 0
    for runs, block, single in _LOOP.findall(body):
        total += int(runs) * (3 + _count(block or single, bodies))  # an iteration compares, adds and jumps
    body = _LOOP.sub("", body)
    body = re.sub(r"^\s*static const.*?;", "", body, flags=re.MULTILINE)
    body = re.sub(r"\[[^\]]*\]|(?<=\d)e[-+]\d+", "", body)
    called = [name for name in re.findall(r"(\w+)\(", body) if name in bodies]
    return total + len(_ARITHMETIC.findall(body)) + sum(2 + _count(bodies[name], bodies) for name in called)
