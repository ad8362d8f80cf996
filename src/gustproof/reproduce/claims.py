"""The paper's claims, judged by the designs and flights of this project."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from gustproof.law.form import Law
from gustproof.model.lpv import RATE_BOUND, RATE_BOUND_IN_TEXT
from gustproof.scoring.metrics import Metrics

TOLERANCE = 0.25
"""[-] relative deviation from the paper's figure that counts as a match. The paper leaves gust, seed and aggregation
open."""


class ClaimVerdict(Enum):
    """Verdict on a claim."""

    HOLDS = "holds"
    """Confirmed here."""
    IN_PART = "holds in part"
    """Holds under a condition that the paper does not state."""
    FAILS = "does not hold"
    """Contradicted here."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """One claim and its verdict."""

    paper: str
    """Statement of the paper."""
    ours: str
    """Finding here."""
    verdict: ClaimVerdict
    """Verdict."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableIII:
    """Attitude errors of the paper's Table III."""

    peak_deg: float
    """[deg] peak magnitude."""
    rmse_deg: float
    """[deg] root mean square error."""


PAPER_PID = TableIII(peak_deg=30.54, rmse_deg=5.67)
PAPER_HINF = TableIII(peak_deg=7.12, rmse_deg=1.35)
PAPER_GAMMA = 0.25
PAPER_LAWS = {"pid-default": PAPER_PID, "hinf-d1": PAPER_HINF}
"""Law of ours for each column of Table III."""

Medians = Mapping[str, Mapping[str, Metrics]]


def judge_claims(
    medians: Medians, laws: Mapping[str, Law], *, norm: float, gamma_opt: float, peak_rate: float
) -> tuple[Claim, ...]:
    """Return a verdict on each claim.

    `medians` holds the figures by law and scenario, and `laws` the laws flown. Both contain `pid-default`, `pid-fair`
    and `hinf-d1`. `norm` is the H-infinity norm of `hinf-d1` in its design model, `gamma_opt` the least level there.
    `peak_rate` [rad/s] is its largest rate on `paper`, over all seeds.
    """
    pid, fair, hinf = (medians[name]["paper"] for name in ("pid-default", "pid-fair", "hinf-d1"))
    outside = [name for name, figures in medians["hinf-d1"].items() if not figures.rho_in_bounds]
    return (
        _judge_count("the H-infinity controller has nine states", laws["hinf-d1"].order, 9),
        _judge_count("the cascaded PID has six states, two per axis", laws["pid-default"].order, 6),
        Claim(
            paper="γ = 0.25 bounds the gain from disturbance and noise to the regulated outputs",
            ours=f"norm {norm:.4f} (least possible {gamma_opt:.4f}), for the linear model at hover, with its leak",
            verdict=ClaimVerdict.IN_PART if norm <= PAPER_GAMMA else ClaimVerdict.FAILS,
        ),
        *(_judge_errors(name, table, medians[name]["paper"]) for name, table in PAPER_LAWS.items()),
        _judge_superiority(hinf, pid, fair),
        Claim(
            paper="H-infinity needs less actuator exertion than PID",
            ours=f"torque slew rms {hinf.torque_slew_rms:.2f} against {pid.torque_slew_rms:.2f} N m/s "
            f"(torque rms {hinf.torque_rms_nm:.3f} against {pid.torque_rms_nm:.3f} N m)",
            verdict=_to_verdict(hinf.torque_slew_rms < pid.torque_slew_rms),
        ),
        Claim(
            paper="p, q, r stay within ±1.5 rad/s (Table II)",
            ours=f"at most {peak_rate:.3f} rad/s",
            verdict=_to_verdict(peak_rate <= RATE_BOUND),
        ),
        Claim(
            paper="p, q, r stay within ±1.5π rad/s (text)",
            ours=f"at most {peak_rate:.3f} rad/s",
            verdict=_to_verdict(peak_rate <= RATE_BOUND_IN_TEXT),
        ),
        Claim(
            paper="no violation of the bounds on ρ under H-infinity",
            ours=f"violated on {', '.join(outside)}" if outside else f"none, on {', '.join(medians['hinf-d1'])}",
            verdict=_judge_bounds(outside),
        ),
    )


def _judge_bounds(outside: list[str]) -> ClaimVerdict:
    """Return the verdict on the bounds on rho from the scenarios that leave them."""
    if not outside:
        return ClaimVerdict.HOLDS
    return ClaimVerdict.FAILS if "paper" in outside else ClaimVerdict.IN_PART


def _judge_count(paper: str, ours: int, expected: int) -> Claim:
    return Claim(paper=paper, ours=f"{ours} states", verdict=_to_verdict(ours == expected))


def _judge_errors(name: str, table: TableIII, ours: Metrics) -> Claim:
    within = (
        abs(ours.peak_deg / table.peak_deg - 1.0) <= TOLERANCE
        and abs(ours.rmse_deg / table.rmse_deg - 1.0) <= TOLERANCE
    )
    kind = "PID" if table is PAPER_PID else "H-infinity"
    return Claim(
        paper=f"{kind}: peak {table.peak_deg:.2f} deg, RMSE {table.rmse_deg:.2f} deg",
        ours=f"{name}: peak {ours.peak_deg:.2f} deg, RMSE {ours.rmse_deg:.2f} deg (within {TOLERANCE:.0%} is a match)",
        verdict=_to_verdict(within),
    )


def _judge_superiority(hinf: Metrics, default: Metrics, fair: Metrics) -> Claim:
    beats = [
        name
        for name, pid in (("default", default), ("fair", fair))
        if hinf.peak_deg < pid.peak_deg and hinf.rmse_deg < pid.rmse_deg
    ]
    return Claim(
        paper="H-infinity holds attitude far better than PID",
        ours=f"RMSE {hinf.rmse_deg:.2f} deg, against {default.rmse_deg:.2f} of the autotuned PID and "
        f"{fair.rmse_deg:.2f} of the fair one",
        verdict=ClaimVerdict.HOLDS if len(beats) == 2 else ClaimVerdict.IN_PART if beats else ClaimVerdict.FAILS,
    )


def _to_verdict(holds: bool) -> ClaimVerdict:
    return ClaimVerdict.HOLDS if holds else ClaimVerdict.FAILS
