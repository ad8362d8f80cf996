from firmware_model.config.scenario import (
    Scenario as Scenario,
)
from firmware_model.config.scenario import (
    list_scenarios as list_scenarios,
)
from firmware_model.config.scenario import (
    load_scenario as load_scenario,
)
from firmware_model.config.uncertainty import VehicleSet as VehicleSet
from firmware_model.config.uncertainty import load_vehicle_set as load_vehicle_set
from firmware_model.config.vehicle import (
    Vehicle as Vehicle,
)
from firmware_model.config.vehicle import (
    list_vehicles as list_vehicles,
)
from firmware_model.config.vehicle import (
    load_vehicle as load_vehicle,
)
from firmware_model.errors import ConfigError as ConfigError
from gustproof.analysis.analyse import analyse as analyse
from gustproof.analysis.law_margins import hover_margins as hover_margins
from gustproof.analysis.law_margins import robust_stability as robust_stability
from gustproof.campaign.executors import process_pool as process_pool
from gustproof.campaign.plan import (
    Campaign as Campaign,
)
from gustproof.campaign.plan import (
    DispersionKind as DispersionKind,
)
from gustproof.campaign.plan import (
    select_spreads as select_spreads,
)
from gustproof.campaign.runner import fly_campaign as fly_campaign
from gustproof.campaign.sampling import Sampling as Sampling
from gustproof.campaign.statistics import compute_statistics as compute_statistics
from gustproof.certify.boundedness import certify_boundedness as certify_boundedness
from gustproof.certify.certificate import Certificate as Certificate
from gustproof.certify.certificate import load_certificate as load_certificate
from gustproof.certify.check.evidence import check_certificate as check_certificate
from gustproof.certify.gain.l2_gain import certify_gain as certify_gain
from gustproof.certify.mu.singular_value import disk_margin_bounds as disk_margin_bounds
from gustproof.certify.mu.singular_value import mu as mu
from gustproof.certify.mu.worst_gain import worst_gain as worst_gain
from gustproof.errors import DesignError as DesignError
from gustproof.falsify.worst_case import WorstCase as WorstCase
from gustproof.falsify.worst_case import worst_case as worst_case
from gustproof.law.discretize import central_law as central_law
from gustproof.law.form import (
    Law as Law,
)
from gustproof.law.form import (
    Output as Output,
)
from gustproof.law.form import (
    Provenance as Provenance,
)
from gustproof.law.form import (
    list_laws as list_laws,
)
from gustproof.law.form import (
    load_law as load_law,
)
from gustproof.law.io.c import save_c as save_c
from gustproof.law.io.matrices import load_mat as load_mat
from gustproof.law.io.matrices import save_mat as save_mat
from gustproof.law.step import LawStepper as LawStepper
from gustproof.lti.margins import margins as margins
from gustproof.lti.norms import h2_norm as h2_norm
from gustproof.lti.norms import hinf_norm as hinf_norm
from gustproof.lti.state_space import Lti as Lti
from gustproof.model.lft import Uncertain as Uncertain
from gustproof.model.lft import close_loop as close_loop
from gustproof.model.lft import ultidyn as ultidyn
from gustproof.model.lft import ureal as ureal
from gustproof.model.reduction import simplify as simplify
from gustproof.model.rotational import (
    uncertain_actuators as uncertain_actuators,
)
from gustproof.model.rotational import (
    uncertain_delay as uncertain_delay,
)
from gustproof.model.uncertainty import Spreads as Spreads
from gustproof.performance.covariance import axis_models as axis_models
from gustproof.performance.limits import (
    full_information_limit as full_information_limit,
)
from gustproof.performance.limits import (
    output_feedback_limit as output_feedback_limit,
)
from gustproof.performance.predict import predict as predict
from gustproof.recording.bag import read_bag as read_bag
from gustproof.recording.bag import write_bag as write_bag
from gustproof.scoring.metrics import Metrics as Metrics
from gustproof.scoring.metrics import measure as measure
from gustproof.scoring.metrics import median_metrics as median_metrics
from gustproof.scoring.requirements import RequirementResult as RequirementResult
from gustproof.scoring.requirements import judge as judge
from gustproof.simulate.batch import Case as Case
from gustproof.simulate.batch import fly_many as fly_many
from gustproof.simulate.direct import fly_direct as fly_direct
from gustproof.simulate.loopback import fly_loopback as fly_loopback
from gustproof.simulate.outcome import FlightOutcome as FlightOutcome
from gustproof.simulate.processes import fly as fly
from gustproof.synthesis.derive import derive as derive
from gustproof.synthesis.designs import (
    Design as Design,
)
from gustproof.synthesis.designs import (
    design_problem as design_problem,
)
from gustproof.synthesis.designs import (
    list_designs as list_designs,
)
from gustproof.synthesis.designs import (
    load_design as load_design,
)
from gustproof.synthesis.hinf.hinfsyn import HinfResult as HinfResult
from gustproof.synthesis.hinf.hinfsyn import hinfsyn as hinfsyn
from gustproof.synthesis.pid.autotune import autotune_pid as autotune_pid
from gustproof.synthesis.pid.identify import identify_rate_loop as identify_rate_loop
from gustproof.synthesis.structured.blocks import (
    Structure as Structure,
)
from gustproof.synthesis.structured.blocks import (
    tunable_gain as tunable_gain,
)
from gustproof.synthesis.structured.blocks import (
    tunable_pid as tunable_pid,
)
from gustproof.synthesis.structured.blocks import (
    tunable_ss as tunable_ss,
)
from gustproof.synthesis.structured.hinfstruct import hinfstruct as hinfstruct
from gustproof.version import __version__ as __version__
