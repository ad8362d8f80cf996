"""Systems joined by the names of their signals."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from gustproof.robust.lti.state_space import Matrix
from gustproof.robust.uncertain.uncertain_system import (
    Known,
    System,
    Uncertain,
    as_given,
    as_uncertain,
    close,
    names_of,
    stack,
)

if TYPE_CHECKING:
    import control


@overload
def connect(*systems: Known, inputs: Sequence[str], outputs: Sequence[str]) -> "control.StateSpace": ...
@overload
def connect(*systems: System, inputs: Sequence[str], outputs: Sequence[str]) -> Uncertain: ...
def connect(*systems: System, inputs: Sequence[str], outputs: Sequence[str]) -> Any:
    """Return systems joined where an output has the name of an input (MATLAB: `connect`).

    Names come from `control.StateSpace`, `control.summing_junction` or `Uncertain.with_names`. An input
    that no output makes must be among `inputs`; any output of a system may be among `outputs`.

    Raises
    ------
    ValueError
        If a signal has no name, two sources or none, or the loop is not well posed.

    Examples
    --------
    >>> from control import ss, summing_junction
    >>> from gustproof.robust import connect, ureal
    >>> plant = (ureal("gain", 1.0, percent=30) * ss(-1.0, 1.0, 1.0, 0.0)).with_names(inputs=["u"], outputs=["y"])
    >>> K = ss([], [], [], 4.0, inputs="e", outputs="u")
    >>> loop = connect(plant, K, summing_junction(["r", "-y"], "e"), inputs=["r"], outputs=["y", "u"])
    >>> loop.outputs, loop.substitute({"gain": 1.3}).poles().real
    (('y', 'u'), array([-6.2]))
    """
    inputs, outputs, together = names_of(inputs), names_of(outputs), stack(*systems)
    made, read = together.outputs, together.inputs
    known = dict.fromkeys((*made, *read))
    for faults, fault in (
        (["" for name in known if not name], "every signal must have a name{}: by with_names, or by control.ss"),
        ([name for name in made if made.count(name) > 1], "two systems make '{}'"),
        ([name for name in inputs if name in made], "'{}' is an input, but a system makes it"),
        ([name for name in read if name not in (*made, *inputs)], "nothing makes '{}': no output, and it is no input"),
        (
            [name for name in (*inputs, *outputs) if name not in known],
            "no signal is named '{}', there are " + ", ".join(known),
        ),
    ):
        if faults:
            raise ValueError(fault.format(faults[0]))
    loop = close(together, _selection(read, made), 1.0) @ _selection(read, inputs)
    # an output may be an input of the whole, passed on
    whole = as_uncertain(_selection(outputs, made)) @ loop + _selection(outputs, inputs)
    return as_given(whole.with_names(inputs=inputs, outputs=outputs), systems)


def _selection(rows: Sequence[str], columns: Sequence[str]) -> Matrix:
    """Return the matrix with 1 where a row and a column have one name."""
    return np.array([[float(row == column) for column in columns] for row in rows]).reshape(len(rows), len(columns))
