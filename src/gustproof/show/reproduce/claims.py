"""The paper's claims, judged by the designs and flights of this project."""

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple

from gustproof.airframe.lpv import RATE_BOUND, RATE_BOUND_IN_TEXT
from gustproof.flight.scoring.metrics import Metrics
from gustproof.law.form import Law

TOLERANCE = 0.25
"""[-] relative deviation from the paper's figure that counts as a match. The paper leaves gust, seed and aggregation
open."""


class ClaimVerdict(Enum):
    """Verdict on a claim."""

    HOLDS = "holds"  # confirmed here
    IN_PART = "holds in part"  # holds under a condition that the paper does not state
    FAILS = "does not hold"  # contradicted here


class PaperClaim(NamedTuple):
    """One claim and its verdict."""

    paper: str
    """Statement of the paper."""
    ours: str
    """Finding here."""
    verdict: ClaimVerdict
    """Verdict."""


PAPER_LAWS = {"pid-default": (30.54, 5.67), "hinf-d1": (7.12, 1.35)}
"""Law of ours for each column of Table III: its peak magnitude and root mean square error [deg]."""
PAPER_GAMMA = 0.25

Medians = Mapping[str, Mapping[str, Metrics]]


def judge_claims(
    medians: Medians, laws: Mapping[str, Law], *, norm: float, gamma_opt: float, peak_rate: float
) -> tuple[PaperClaim, ...]:
    """Return a verdict on each claim.

    `medians` holds the figures by law and scenario, and `laws` the laws flown. Both contain `pid-default`, `pid-fair`
    and `hinf-d1`. `norm` is the H-infinity norm of `hinf-d1` in its design model, `gamma_opt` the least level there.
    `peak_rate` [rad/s] is its largest rate on `paper`, over all seeds.
    """
    pid, fair, hinf = (medians[name]["paper"] for name in ("pid-default", "pid-fair", "hinf-d1"))
    outside = [name for name, figures in medians["hinf-d1"].items() if not figures.rho_in_bounds]
    level = f"norm {norm:.4f} (least possible {gamma_opt:.4f}), for the linear model at hover, with its leak"
    exertion = (
        f"torque slew rms {hinf.torque_slew_rms:.2f} against {pid.torque_slew_rms:.2f} N m/s "
        f"(torque rms {hinf.torque_rms_nm:.3f} against {pid.torque_rms_nm:.3f} N m)"
    )
    rate = f"at most {peak_rate:.3f} rad/s"
    left = f"violated on {', '.join(outside)}" if outside else f"none, on {', '.join(medians['hinf-d1'])}"
    in_bounds = ClaimVerdict.HOLDS if not outside else ClaimVerdict.IN_PART
    return (
        _judge_count("the H-infinity controller has nine states", laws["hinf-d1"].order, 9),
        _judge_count("the cascaded PID has six states, two per axis", laws["pid-default"].order, 6),
        PaperClaim(
            "γ = 0.25 bounds the gain from disturbance and noise to the regulated outputs",
            level,
            ClaimVerdict.IN_PART if norm <= PAPER_GAMMA else ClaimVerdict.FAILS,
        ),
        *(_judge_errors(name, *figures, medians[name]["paper"]) for name, figures in PAPER_LAWS.items()),
        _judge_superiority(hinf, pid, fair),
        _judge(
            "H-infinity needs less actuator exertion than PID", exertion, hinf.torque_slew_rms < pid.torque_slew_rms
        ),
        _judge("p, q, r stay within ±1.5 rad/s (Table II)", rate, peak_rate <= RATE_BOUND),
        _judge("p, q, r stay within ±1.5π rad/s (text)", rate, peak_rate <= RATE_BOUND_IN_TEXT),
        PaperClaim(
            "no violation of the bounds on ρ under H-infinity",
            left,
            ClaimVerdict.FAILS if "paper" in outside else in_bounds,
        ),
    )


def _judge(paper: str, ours: str, holds: bool) -> PaperClaim:
    return PaperClaim(paper, ours, ClaimVerdict.HOLDS if holds else ClaimVerdict.FAILS)


def _judge_count(paper: str, ours: int, expected: int) -> PaperClaim:
    return _judge(paper, f"{ours} states", ours == expected)


def _judge_errors(name: str, peak: float, rmse: float, ours: Metrics) -> PaperClaim:
    ratios = ours.peak_deg / peak, ours.rmse_deg / rmse
    paper = f"{'PID' if name == 'pid-default' else 'H-infinity'}: peak {peak:.2f} deg, RMSE {rmse:.2f} deg"
    figures = f"{name}: peak {ours.peak_deg:.2f} deg, RMSE {ours.rmse_deg:.2f} deg (within {TOLERANCE:.0%} is a match)"
    return _judge(paper, figures, all(abs(ratio - 1.0) <= TOLERANCE for ratio in ratios))


def _judge_superiority(hinf: Metrics, default: Metrics, fair: Metrics) -> PaperClaim:
    beaten = sum(hinf.peak_deg < pid.peak_deg and hinf.rmse_deg < pid.rmse_deg for pid in (default, fair))
    return PaperClaim(
        "H-infinity holds attitude far better than PID",
        f"RMSE {hinf.rmse_deg:.2f} deg, against {default.rmse_deg:.2f} of the autotuned PID and "
        f"{fair.rmse_deg:.2f} of the fair one",
        (ClaimVerdict.FAILS, ClaimVerdict.IN_PART, ClaimVerdict.HOLDS)[beaten],
    )
