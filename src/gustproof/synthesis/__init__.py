"""Controllers from design models: H-infinity, self-scheduled and PID; what comes out is a `gustproof.law.Law`."""

from gustproof.synthesis.autotune import autotuned_pid
from gustproof.synthesis.derive import derive
from gustproof.synthesis.designs import load_design
from gustproof.synthesis.discretize import central_law
from gustproof.synthesis.fair import fair_pid
from gustproof.synthesis.hinfsyn import HinfResult, hinfsyn

__all__ = ["HinfResult", "autotuned_pid", "central_law", "derive", "fair_pid", "hinfsyn", "load_design"]
