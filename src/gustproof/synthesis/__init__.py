"""Controllers from design models: H-infinity, self-scheduled and PID; what comes out is a `gustproof.law.Law`."""

from gustproof.synthesis.autotune import autotuned_pid
from gustproof.synthesis.derive import derive
from gustproof.synthesis.designs import load_design
from gustproof.synthesis.discretize import central_law
from gustproof.synthesis.fair import fair_pid
from gustproof.synthesis.hinfsyn import HinfResult, hinfsyn
from gustproof.synthesis.structured import StructResult, hinfstruct

__all__ = [
    "HinfResult",
    "StructResult",
    "autotuned_pid",
    "central_law",
    "derive",
    "fair_pid",
    "hinfstruct",
    "hinfsyn",
    "load_design",
]
