"""Controllers from design models: H-infinity, self-scheduled and PID; what comes out is a `gustproof.law.Law`."""

from gustproof.synthesis.discretize import central_law
from gustproof.synthesis.hinfsyn import HinfResult, hinfsyn

__all__ = ["HinfResult", "central_law", "hinfsyn"]
