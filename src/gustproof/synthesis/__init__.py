"""Controllers from design models, as a `gustproof.law.Law`: H-infinity, PID, INDI; and what no law can beat."""

from gustproof.synthesis.autotune import autotuned_pid
from gustproof.synthesis.derive import derive
from gustproof.synthesis.designs import load_design
from gustproof.synthesis.discretize import central_law
from gustproof.synthesis.fair import fair_pid
from gustproof.synthesis.flagship import flagship
from gustproof.synthesis.foretold import foretell
from gustproof.synthesis.hinfsyn import HinfResult, hinfsyn
from gustproof.synthesis.indi import indi
from gustproof.synthesis.limits import clairvoyant_limit, gyro_limit
from gustproof.synthesis.structured import StructResult, hinfstruct
from gustproof.synthesis.tradeoff import linear_laws
from gustproof.synthesis.turbulence import axis_models

__all__ = [
    "HinfResult",
    "StructResult",
    "autotuned_pid",
    "axis_models",
    "central_law",
    "clairvoyant_limit",
    "derive",
    "fair_pid",
    "flagship",
    "foretell",
    "gyro_limit",
    "hinfstruct",
    "hinfsyn",
    "indi",
    "linear_laws",
    "load_design",
]
