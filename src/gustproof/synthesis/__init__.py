"""Synthesise controllers as a `gustproof.law.form.Law`: H-infinity, PID, INDI; and bounds that hold for all laws."""

from gustproof.law.discretize import central_law
from gustproof.performance.covariance import axis_models
from gustproof.performance.limits import full_information_limit, output_feedback_limit
from gustproof.performance.predict import predict
from gustproof.performance.tradeoff import linear_laws
from gustproof.synthesis.derive import derive
from gustproof.synthesis.designs import load_design
from gustproof.synthesis.hinf.hinfsyn import HinfResult, hinfsyn
from gustproof.synthesis.pid.autotune import autotune_pid
from gustproof.synthesis.pid.flagship import flagship_law
from gustproof.synthesis.pid.indi import indi_law
from gustproof.synthesis.pid.pid_baseline import baseline_pid
from gustproof.synthesis.structured.hinfstruct import StructResult, hinfstruct

__all__ = [
    "HinfResult",
    "StructResult",
    "autotune_pid",
    "axis_models",
    "baseline_pid",
    "central_law",
    "derive",
    "flagship_law",
    "full_information_limit",
    "hinfstruct",
    "hinfsyn",
    "indi_law",
    "linear_laws",
    "load_design",
    "output_feedback_limit",
    "predict",
]
