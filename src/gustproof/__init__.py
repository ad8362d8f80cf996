"""Design, prove and fly multirotor attitude control in gusts, over real MAVLink.

The public API: each name in `__all__` has an example in its docstring, and is loaded when it is first used.
"""

from importlib import import_module

from gustproof.version import __version__

TYPE_CHECKING = False  # type checkers take it as True; to import `typing` takes longer than all the rest

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario, list_scenarios, load_scenario
    from firmware_model.config.uncertainty import VehicleSet, load_vehicle_set
    from firmware_model.config.vehicle import Vehicle, list_vehicles, load_vehicle
    from firmware_model.errors import ConfigError
    from gustproof.analysis.analyse import analyse
    from gustproof.analysis.law_margins import hover_margins
    from gustproof.analysis.robustness import robust_stability
    from gustproof.campaign.executors import process_pool
    from gustproof.campaign.plan import Campaign, DispersionKind, select_spreads
    from gustproof.campaign.runner import fly_campaign
    from gustproof.campaign.sampling import Sampling
    from gustproof.campaign.statistics import compute_statistics
    from gustproof.certify.boundedness import FlightCertificate, certify_boundedness
    from gustproof.certify.certificate import Certificate
    from gustproof.certify.check.evidence import check as check_certificate
    from gustproof.certify.check.flight_box import MomentClass
    from gustproof.certify.gain.l2_gain import certify_gain
    from gustproof.certify.mu.singular_value import disk_margin_bounds, mu
    from gustproof.certify.mu.worst_gain import worst_gain
    from gustproof.errors import DesignError
    from gustproof.falsify.worst_case import WorstCase, worst_case
    from gustproof.law.discretize import central_law
    from gustproof.law.form import Law, Output, Provenance, load_law, shipped_laws
    from gustproof.law.io.c import save_c
    from gustproof.law.io.matrices import load_mat, save_mat
    from gustproof.law.step import LawStepper
    from gustproof.lti.margins import margins
    from gustproof.lti.norms import h2_norm, hinf_norm
    from gustproof.lti.state_space import Lti
    from gustproof.model.lft import Uncertain, close_loop, ultidyn, ureal
    from gustproof.model.reduction import simplify
    from gustproof.model.rotational import uncertain_actuators, uncertain_delay
    from gustproof.model.uncertainty import Spreads
    from gustproof.performance.covariance import axis_models
    from gustproof.performance.limits import full_information_limit, output_feedback_limit
    from gustproof.performance.predict import predict
    from gustproof.recording.bag import read_bag, write_bag
    from gustproof.scoring.metrics import Metrics, measure, median_metrics
    from gustproof.scoring.requirements import RequirementResult, judge
    from gustproof.simulate.batch import Case, fly_many
    from gustproof.simulate.direct import fly_direct
    from gustproof.simulate.loopback import fly_loopback
    from gustproof.simulate.outcome import FlightOutcome
    from gustproof.simulate.processes import fly
    from gustproof.synthesis.derive import derive
    from gustproof.synthesis.designs import Design, design_problem, load_design, shipped_designs
    from gustproof.synthesis.hinf.hinfsyn import HinfResult, hinfsyn
    from gustproof.synthesis.pid.autotune import autotune_pid
    from gustproof.synthesis.pid.identify import identify_rate_loop
    from gustproof.synthesis.structured.blocks import Structure, tunable_gain, tunable_pid, tunable_ss
    from gustproof.synthesis.structured.hinfstruct import hinfstruct

__all__ = [
    "Campaign",
    "Case",
    "Certificate",
    "ConfigError",
    "Design",
    "DesignError",
    "DispersionKind",
    "FlightCertificate",
    "FlightOutcome",
    "HinfResult",
    "Law",
    "LawStepper",
    "Lti",
    "Metrics",
    "MomentClass",
    "Output",
    "Provenance",
    "RequirementResult",
    "Sampling",
    "Scenario",
    "Spreads",
    "Structure",
    "Uncertain",
    "Vehicle",
    "VehicleSet",
    "WorstCase",
    "__version__",
    "analyse",
    "autotune_pid",
    "axis_models",
    "central_law",
    "certify_boundedness",
    "certify_gain",
    "check_certificate",
    "close_loop",
    "compute_statistics",
    "derive",
    "design_problem",
    "disk_margin_bounds",
    "fly",
    "fly_campaign",
    "fly_direct",
    "fly_loopback",
    "fly_many",
    "full_information_limit",
    "h2_norm",
    "hinf_norm",
    "hinfstruct",
    "hinfsyn",
    "hover_margins",
    "identify_rate_loop",
    "judge",
    "list_scenarios",
    "list_vehicles",
    "load_design",
    "load_law",
    "load_mat",
    "load_scenario",
    "load_vehicle",
    "load_vehicle_set",
    "margins",
    "measure",
    "median_metrics",
    "mu",
    "output_feedback_limit",
    "predict",
    "process_pool",
    "read_bag",
    "robust_stability",
    "save_c",
    "save_mat",
    "select_spreads",
    "shipped_designs",
    "shipped_laws",
    "simplify",
    "tunable_gain",
    "tunable_pid",
    "tunable_ss",
    "ultidyn",
    "uncertain_actuators",
    "uncertain_delay",
    "ureal",
    "worst_case",
    "worst_gain",
    "write_bag",
]

_SOURCES = {
    "firmware_model.config.scenario": "Scenario list_scenarios load_scenario",
    "firmware_model.config.uncertainty": "VehicleSet load_vehicle_set",
    "firmware_model.config.vehicle": "Vehicle list_vehicles load_vehicle",
    "firmware_model.errors": "ConfigError",
    "gustproof.analysis.analyse": "analyse",
    "gustproof.analysis.law_margins": "hover_margins",
    "gustproof.analysis.robustness": "robust_stability",
    "gustproof.campaign.executors": "process_pool",
    "gustproof.campaign.plan": "Campaign DispersionKind select_spreads",
    "gustproof.campaign.runner": "fly_campaign",
    "gustproof.campaign.sampling": "Sampling",
    "gustproof.campaign.statistics": "compute_statistics",
    "gustproof.certify.boundedness": "FlightCertificate certify_boundedness",
    "gustproof.certify.certificate": "Certificate",
    "gustproof.certify.check.evidence": "check_certificate:check",
    "gustproof.certify.check.flight_box": "MomentClass",
    "gustproof.certify.gain.l2_gain": "certify_gain",
    "gustproof.certify.mu.singular_value": "disk_margin_bounds mu",
    "gustproof.certify.mu.worst_gain": "worst_gain",
    "gustproof.errors": "DesignError",
    "gustproof.falsify.worst_case": "WorstCase worst_case",
    "gustproof.law.discretize": "central_law",
    "gustproof.law.form": "Law Output Provenance load_law shipped_laws",
    "gustproof.law.io.c": "save_c",
    "gustproof.law.io.matrices": "load_mat save_mat",
    "gustproof.law.step": "LawStepper",
    "gustproof.lti.margins": "margins",
    "gustproof.lti.norms": "h2_norm hinf_norm",
    "gustproof.lti.state_space": "Lti",
    "gustproof.model.lft": "Uncertain close_loop ultidyn ureal",
    "gustproof.model.reduction": "simplify",
    "gustproof.model.rotational": "uncertain_actuators uncertain_delay",
    "gustproof.model.uncertainty": "Spreads",
    "gustproof.performance.covariance": "axis_models",
    "gustproof.performance.limits": "full_information_limit output_feedback_limit",
    "gustproof.performance.predict": "predict",
    "gustproof.recording.bag": "read_bag write_bag",
    "gustproof.scoring.metrics": "Metrics measure median_metrics",
    "gustproof.scoring.requirements": "RequirementResult judge",
    "gustproof.simulate.batch": "Case fly_many",
    "gustproof.simulate.direct": "fly_direct",
    "gustproof.simulate.loopback": "fly_loopback",
    "gustproof.simulate.outcome": "FlightOutcome",
    "gustproof.simulate.processes": "fly",
    "gustproof.synthesis.derive": "derive",
    "gustproof.synthesis.designs": "Design design_problem load_design shipped_designs",
    "gustproof.synthesis.hinf.hinfsyn": "HinfResult hinfsyn",
    "gustproof.synthesis.pid.autotune": "autotune_pid",
    "gustproof.synthesis.pid.identify": "identify_rate_loop",
    "gustproof.synthesis.structured.blocks": "Structure tunable_gain tunable_pid tunable_ss",
    "gustproof.synthesis.structured.hinfstruct": "hinfstruct",
}
"""Public names by their module; a name that differs there stands behind a colon."""
_HOLDERS = {
    name: (module, attribute or name)
    for module, names in _SOURCES.items()
    for name, _, attribute in (each.partition(":") for each in names.split())
}


if not TYPE_CHECKING:  # a type checker that saw this would believe in any name

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used (PEP 562)."""
        if name not in _HOLDERS:
            raise AttributeError(f"module 'gustproof' has no attribute '{name}'")
        module, attribute = _HOLDERS[name]
        value = globals()[name] = getattr(import_module(module), attribute)
        return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
