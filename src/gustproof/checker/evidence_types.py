"""Names of all that the checker reads: evidence of each kind, and the files of law, vehicle and scenario.

These types say what a well-formed document holds. Nothing here checks it: texts come from strangers, and whoever reads
an entry refuses what is no such thing.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Literal, NotRequired, Required, TypedDict

Matrix = Sequence[Sequence[float | Fraction]]
"""A matrix by rows, as numbers of a file or exact."""


class SpreadTable(TypedDict):
    """Number of a vehicle file that is known within an interval."""

    nominal: float
    low: float
    high: float


End = Literal["nominal", "low", "high"]
Entry = float | SpreadTable
"""Number of a vehicle file, spread or not."""


class MultiplierTable(TypedDict, total=False):
    """Numbers of a part's constraint, see `quadratic_constraints`; each kind of part has its own."""

    D: Matrix
    G: Matrix
    X: Matrix
    Y: Matrix
    T: Sequence[float]
    causal: Matrix
    anticausal: Matrix


class PartTable(TypedDict, total=False):
    """Kind and size of a part of Delta; empty for a real parameter."""

    kind: str
    largest: float
    """[s] delay."""
    odd: bool


class BlockTable(PartTable, MultiplierTable):
    """Part of Delta, with the multipliers of its constraint unless these depend on the vertex."""

    name: Required[str]
    size: Required[int]
    speed: NotRequired[float | None]
    """[1/s] of a normalised parameter."""
    poles: NotRequired[Sequence[float]]
    """[rad/s] of the constraint's filter."""


class SystemMatrices(TypedDict):
    """Continuous system, closed by Delta."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


class LoopEvidence(TypedDict):
    """Entries that the evidence of every gain has."""

    level: float
    system: SystemMatrices
    coordinates: Matrix
    """Of the state in which P and Y are stated."""
    blocks: Sequence[BlockTable]
    radius: NotRequired[dict[str, list[list[Fraction]]] | None]
    """Never in a file: distances of the derived loop's numbers, see `DerivedLoop`."""


class GainEvidence(LoopEvidence):
    """Evidence of an L2 gain for parameters of any speed."""

    kind: Literal["gain"]
    P: Matrix


class ConstrainedGainEvidence(LoopEvidence):
    """Evidence of an L2 gain with parts of which only integral quadratic constraints are known."""

    kind: Literal["constrained gain"]
    P: Matrix
    stability: Matrix
    """Lyapunov matrix of the system and its filters alone."""


class SlowGainEvidence(LoopEvidence):
    """Evidence of an L2 gain with bounds on the speeds of some parameters."""

    kind: Literal["slow gain"]
    P: Sequence[Matrix]
    """Of each set of slow parameters."""
    Y: Matrix
    vertices: Sequence[Sequence[MultiplierTable]]


AnyGainEvidence = GainEvidence | ConstrainedGainEvidence | SlowGainEvidence


class FlightEvidence(TypedDict):
    """Evidence of a flight's box; `FlightClaim` says what each entry means."""

    kind: Literal["boundedness"]
    law_sha256: str
    vehicle_sha256: str
    moment: list[float]
    part: float
    moment_class: str
    slope: list[float]
    horizon: float | None
    noise: float
    risk: float
    inertia_spread: float
    lag_spread: float
    cells: list[int]
    samples: int
    box: list[list[float]]


class ChanceEvidence(TypedDict):
    """Evidence of a flight's box in turbulence."""

    kind: Literal["chance"]
    law_sha256: str
    vehicle_sha256: str
    scenario_sha256: str
    risk: float
    samples: int
    box: list[list[float]]


class Figures(TypedDict, total=False):
    """Proved figures: the gain, or those of a flight's box."""

    gain: float
    part: float
    moment_class: str
    risk: float
    horizon_s: float
    estimate_deg: list[float]
    truth_deg: list[float | None] | None
    torque_nm: list[float]
    lower_bound: float
    """Reached by a simulation, no part of the proof."""


AnyEvidence = AnyGainEvidence | FlightEvidence | ChanceEvidence
Assumptions = dict[str, object]
"""Assumptions by name, JSON values."""


class RateLimitTable(TypedDict):
    """Limit of the rate commanded from attitude, in a law file."""

    S: list[list[float]]
    T: list[list[float]]
    limits: list[float]


class LawDocument(TypedDict):
    """Law file."""

    format: str
    name: str
    output: str
    dt: float
    limits: list[float]
    A: list[list[float]]
    B: list[list[float]]
    C: list[list[float]]
    D: list[list[float]]
    G: list[list[float]]
    rate_limit: NotRequired[RateLimitTable | None]
    schedule: NotRequired[object]


class GyroTable(TypedDict):
    """Gyro of a vehicle file."""

    range: Entry
    snr_db: Entry
    reference_rate: Entry
    noise_model: NotRequired[str]
    bias_B: NotRequired[list[Entry]]


class AccelerometerTable(TypedDict, total=False):
    """Accelerometer of a vehicle file."""

    range: Entry
    noise_density: Entry


class StabilizerTable(TypedDict):
    """On-board rate loop of a vehicle file."""

    rate_p: list[Entry]
    rate_i: list[Entry]
    rate_d: list[Entry]
    derivative_cutoff: Entry


class RotorsTable(TypedDict):
    """Rotors of a vehicle file."""

    position_B: list[list[Entry]]


class CommandTable(TypedDict, total=False):
    """Measured command of a vehicle file."""

    delay: Entry


class VehicleDocument(TypedDict):
    """Vehicle file, as far as a proof reads it by name."""

    inertia_B: list[Entry]
    actuator_lag: Entry
    torque_limit: list[Entry]
    heave_drag: Entry
    span: Entry
    gust_gain: Entry
    gust_yaw_ratio: Entry
    gyro: GyroTable
    stabilizer: StabilizerTable
    rotors: RotorsTable
    rate_damping: NotRequired[Entry | list[Entry]]
    accelerometer: NotRequired[AccelerometerTable]
    command: NotRequired[CommandTable]


class WindTable(TypedDict):
    """Turbulence of a scenario file."""

    kind: str
    intensity: NotRequired[str]
    wind_speed_20ft_mps: NotRequired[float]
    airspeed_mps: NotRequired[float]
    specification: NotRequired[str]
