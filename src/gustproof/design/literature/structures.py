"""The laws of the literature that `tune` can search. Nothing is imported here, so a command line starts fast."""

from collections.abc import Mapping

BASELINES: Mapping[str, str | None] = {
    "lqg": "lqg:LQG",
    "loop-shaping": "loop_shaping:LOOP_SHAPING",
    "adrc": "adrc:ADRC",
    "l1": "l1:L1",
    "dob": "dob:DOB",
    "px4": None,
    "ardupilot": None,
}
"""Module of this folder and name of its `AxisStructure`; `None` for the cascade of an autopilot."""
