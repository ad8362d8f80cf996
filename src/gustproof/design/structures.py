"""The structures of laws that `tune` can search. Nothing is imported here, so a command line starts fast."""

from collections.abc import Mapping
from enum import StrEnum


class LawKind(StrEnum):
    """Structure of a law."""

    FLAGSHIP = "flagship"
    """Strapdown cascade with a biquad."""
    PID = "pid"
    """Strapdown cascade, the structure of the law `pid-fair`."""
    INDI = "indi"
    """Incremental nonlinear dynamic inversion."""
    AIDED = "aided"
    """The flagship's cascade, levelled by the accelerometer."""
    HINF = "hinf"
    """Self-scheduled H-infinity law of gyros alone, weighted by the gusts' spectrum."""
    HINF_RATES = "hinf-rates"
    """H-infinity law that commands rates to the vehicle's own loops."""


BASELINES: Mapping[str, str | None] = {
    "lqg": "lqg:LQG",
    "loop-shaping": "loop_shaping:LOOP_SHAPING",
    "adrc": "adrc:ADRC",
    "l1": "l1:L1",
    "dob": "dob:DOB",
    "px4": None,
    "ardupilot": None,
}
"""Laws of the literature: module there and name of its `AxisStructure`; `None` for the cascade of an autopilot."""
