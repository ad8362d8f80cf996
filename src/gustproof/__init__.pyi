from firmware_model.config.scenario import (
    Scenario as Scenario,
    list_scenarios as list_scenarios,
    load_scenario as load_scenario,
)
from firmware_model.config.uncertainty import VehicleSet as VehicleSet, load_vehicle_set as load_vehicle_set
from firmware_model.config.vehicle import (
    Vehicle as Vehicle,
    list_vehicles as list_vehicles,
    load_vehicle as load_vehicle,
)
from firmware_model.errors import ConfigError as ConfigError
from gustproof.analysis.analyse import analyse as analyse
from gustproof.analysis.law_margins import hover_margins as hover_margins, robust_stability as robust_stability
from gustproof.campaign.executors import process_pool as process_pool
from gustproof.campaign.plan import (
    Campaign as Campaign,
    DispersionKind as DispersionKind,
    select_spreads as select_spreads,
)
from gustproof.campaign.runner import fly_campaign as fly_campaign
from gustproof.campaign.sampling import Sampling as Sampling
from gustproof.campaign.statistics import compute_statistics as compute_statistics
from gustproof.certify.boundedness import certify_boundedness as certify_boundedness
from gustproof.certify.certificate import Certificate as Certificate, load_certificate as load_certificate
from gustproof.certify.check.evidence import check_certificate as check_certificate
from gustproof.certify.gain.l2_gain import certify_gain as certify_gain
from gustproof.certify.mu.singular_value import disk_margin_bounds as disk_margin_bounds, mu as mu
from gustproof.certify.mu.worst_gain import worst_gain as worst_gain
from gustproof.errors import DesignError as DesignError
from gustproof.falsify.worst_case import WorstCase as WorstCase, worst_case as worst_case
from gustproof.law.discretize import central_law as central_law
from gustproof.law.form import (
    Law as Law,
    Output as Output,
    Provenance as Provenance,
    list_laws as list_laws,
    load_law as load_law,
)
from gustproof.law.io.c import save_c as save_c
from gustproof.law.io.matrices import load_mat as load_mat, save_mat as save_mat
from gustproof.law.step import LawStepper as LawStepper
from gustproof.lti.margins import margins as margins
from gustproof.lti.norms import h2_norm as h2_norm, hinf_norm as hinf_norm
from gustproof.lti.state_space import Lti as Lti
from gustproof.model.lft import Uncertain as Uncertain, close_loop as close_loop, ultidyn as ultidyn, ureal as ureal
from gustproof.model.reduction import simplify as simplify
from gustproof.model.rotational import (
    uncertain_actuators as uncertain_actuators,
    uncertain_delay as uncertain_delay,
)
from gustproof.model.uncertainty import Spreads as Spreads
from gustproof.performance.covariance import axis_models as axis_models
from gustproof.performance.limits import (
    full_information_limit as full_information_limit,
    output_feedback_limit as output_feedback_limit,
)
from gustproof.performance.predict import predict as predict
from gustproof.recording.bag import read_bag as read_bag, write_bag as write_bag
from gustproof.scoring.metrics import Metrics as Metrics, measure as measure, median_metrics as median_metrics
from gustproof.scoring.requirements import RequirementResult as RequirementResult, judge as judge
from gustproof.simulate.batch import Case as Case, fly_many as fly_many
from gustproof.simulate.direct import fly_direct as fly_direct
from gustproof.simulate.loopback import fly_loopback as fly_loopback
from gustproof.simulate.outcome import FlightOutcome as FlightOutcome
from gustproof.simulate.processes import fly as fly
from gustproof.synthesis.derive import derive as derive
from gustproof.synthesis.designs import (
    Design as Design,
    design_problem as design_problem,
    list_designs as list_designs,
    load_design as load_design,
)
from gustproof.synthesis.hinf.hinfsyn import HinfResult as HinfResult, hinfsyn as hinfsyn
from gustproof.synthesis.pid.autotune import autotune_pid as autotune_pid
from gustproof.synthesis.pid.identify import identify_rate_loop as identify_rate_loop
from gustproof.synthesis.structured.blocks import (
    Structure as Structure,
    tunable_gain as tunable_gain,
    tunable_pid as tunable_pid,
    tunable_ss as tunable_ss,
)
from gustproof.synthesis.structured.hinfstruct import hinfstruct as hinfstruct
from gustproof.version import __version__ as __version__
