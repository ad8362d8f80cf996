"""Parameters of an autopilot, read back before it flies: finds a file never read, or a name that it ignored."""

import math
from collections.abc import Collection, Mapping

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.messages import is_whole_parameter, parse_parameter

_AT_ONCE = 10  # asked for at once; an autopilot queues few
_ASKS = 3  # requests without an answer until a parameter is unknown
_FLOAT32 = 1e-6  # relative; an autopilot keeps single precision


class ParameterReader:
    """Reads parameters of one autopilot: send requests for `next_names`, `take` the answers until `finished`.

    `values` were set, and are compared. Of these `vital` ones must be there; `optional` ones are of some versions
    alone. The `watched` are reported as read. With `bytewise` whole numbers come as bits of the float field.
    """

    def __init__(
        self,
        values: Mapping[str, str] | None = None,
        *,
        vital: Collection[str] = (),
        optional: Collection[str] = (),
        watched: Collection[str] = (),
        bytewise: bool = True,
    ) -> None:
        self._values = {name: float(value) for name, value in (values or {}).items()}
        self._vital, self._optional, self._bytewise = frozenset(vital), frozenset(optional), bytewise
        self._asked = dict.fromkeys((*self._values, *watched), 0)
        self._absent: list[str] = []
        self._whole: set[str] = set()
        self.reported: dict[str, float] = {}

    @property
    def finished(self) -> bool:
        """True once each parameter has been reported, or asked for in vain."""
        return not self._asked

    @property
    def unknown(self) -> list[str]:
        """Names that were set and that the autopilot did not answer for, but for the optional ones."""
        return [name for name in self._absent if name in self._values and name not in self._optional]

    @property
    def rounded(self) -> dict[str, float]:
        """Values that the autopilot keeps as whole numbers, where a fraction was set."""
        return {name: reported for name, reported in self._differing().items() if self._is_cut(name, reported)}

    def next_names(self) -> list[str]:
        """Return the names to ask for now, those that were asked for least; call it at a steady pace."""
        for name in [name for name, asks in self._asked.items() if asks >= _ASKS]:
            del self._asked[name]
            self._absent.append(name)
        names = sorted(self._asked, key=self._asked.__getitem__)[:_AT_ONCE]
        for name in names:
            self._asked[name] += 1
        return names

    def take(self, message: Message) -> None:
        """Take a PARAM_VALUE."""
        name = message.param_id
        if name in self._asked or name in self._absent:
            self._asked.pop(name, None)
            self._absent = [each for each in self._absent if each != name]
            self.reported[name] = parse_parameter(message, bytewise=self._bytewise)
            if is_whole_parameter(message):
                self._whole.add(name)

    def describe_faults(self) -> str:
        """Return in words why a flight with these parameters is not the one that was asked for; empty if it is."""
        if self._values and not self._values.keys() & self.reported.keys():
            return f"it answers for none of the {len(self._values)} parameters that were set"
        if absent := [name for name in self.unknown if name in self._vital]:
            return f"it has no parameter {absent[0]}{_more(absent)}"
        wrong = {name: reported for name, reported in self._differing().items() if not self._is_cut(name, reported)}
        for name, reported in wrong.items():
            return f"it has {name} {reported:.7g} where {self._values[name]:.7g} was set{_more(wrong)}"
        return ""

    def _differing(self) -> dict[str, float]:
        pairs = {name: (self.reported[name], value) for name, value in self._values.items() if name in self.reported}
        return {
            name: reported
            for name, (reported, value) in pairs.items()
            if not math.isclose(reported, value, rel_tol=_FLOAT32)
        }

    def _is_cut(self, name: str, reported: float) -> bool:
        given = self._values[name]
        return name in self._whole and not given.is_integer() and abs(reported - given) < 1.0


def _more(names: Collection[str]) -> str:
    return f", and {len(names) - 1} more like it" if len(names) > 1 else ""
