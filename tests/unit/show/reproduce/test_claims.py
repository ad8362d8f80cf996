"""Verdicts follow the figures: each one turns when its figure does."""

from dataclasses import replace

import numpy as np
import pytest

from gustproof.flight.scoring.metrics import Metrics
from gustproof.law.form import Law, Output, Provenance
from gustproof.show.reproduce.claims import TOLERANCE, ClaimVerdict, judge_claims

CALM = Metrics(
    peak_deg=1.0, rmse_deg=0.1, peak_roll_deg=1.0, peak_pitch_deg=1.0, peak_settled_deg=1.0,
    peak_yaw_deg=1.0, rmse_roll_deg=0.1,
    rmse_pitch_deg=0.1, rmse_yaw_deg=0.1, torque_rms_nm=0.2, torque_peak_nm=0.9, torque_slew_rms=20.0,
    saturated_s=0.0, rho_in_bounds=True, realtime_factor=100.0,
)  # fmt: skip
PID = replace(CALM, peak_deg=30.54, rmse_deg=5.67, torque_slew_rms=1.0)
HINF = replace(CALM, peak_deg=7.12, rmse_deg=1.35, torque_slew_rms=2.8)


def law(order: int) -> Law:
    return Law(
        name="law", A=np.zeros((order, order)), B=np.zeros((order, 6)), C=np.zeros((3, order)), D=np.zeros((3, 6)),
        G=np.zeros((order, 3)), H=np.zeros((order, 3)), dt=0.004, limits=np.ones(3), output=Output.TORQUE,
        provenance=Provenance(design="", vehicle="paper"),
    )  # fmt: skip


def verdicts(*, pid=PID, fair=CALM, hinf=HINF, coning=HINF, states=9, pid_states=6, norm=0.249, rate=1.0):
    medians = {
        "pid-default": {"paper": pid, "coning": pid},
        "pid-fair": {"paper": fair, "coning": fair},
        "hinf-d1": {"paper": hinf, "coning": coning},
    }
    laws = {"pid-default": law(pid_states), "hinf-d1": law(states)}
    claims = judge_claims(medians, laws, norm=norm, gamma_opt=0.2136, peak_rate=rate)
    return {claim.paper: claim.verdict for claim in claims}


def one(found, *words):
    (verdict,) = [verdict for paper, verdict in found.items() if all(word in paper for word in words)]
    return verdict


@pytest.mark.parametrize(
    ("words", "change", "verdict"),
    [
        (("nine",), {}, ClaimVerdict.HOLDS),
        (("nine",), {"states": 8}, ClaimVerdict.FAILS),
        (("six states",), {}, ClaimVerdict.HOLDS),
        (("six states",), {"pid_states": 9}, ClaimVerdict.FAILS),
        (("γ",), {}, ClaimVerdict.IN_PART),
        (("γ",), {"norm": 0.2501}, ClaimVerdict.FAILS),
        (("PID: peak",), {}, ClaimVerdict.HOLDS),
        (("PID: peak",), {"pid": replace(PID, rmse_deg=5.67 * (1.01 + TOLERANCE))}, ClaimVerdict.FAILS),
        (("H-infinity: peak",), {}, ClaimVerdict.HOLDS),
        (("H-infinity: peak",), {"hinf": replace(HINF, peak_deg=7.12 * (0.99 - TOLERANCE))}, ClaimVerdict.FAILS),
        (("far better",), {}, ClaimVerdict.IN_PART),
        (("far better",), {"fair": PID}, ClaimVerdict.HOLDS),
        (("far better",), {"pid": CALM}, ClaimVerdict.FAILS),
        (("exertion",), {}, ClaimVerdict.FAILS),
        (("exertion",), {"hinf": replace(HINF, torque_slew_rms=0.9)}, ClaimVerdict.HOLDS),
        (("±1.5 rad/s",), {}, ClaimVerdict.HOLDS),
        (("±1.5 rad/s",), {"rate": 1.6}, ClaimVerdict.FAILS),
        (("±1.5π",), {"rate": 1.6}, ClaimVerdict.HOLDS),
        (("±1.5π",), {"rate": 4.8}, ClaimVerdict.FAILS),
        (("no violation",), {}, ClaimVerdict.HOLDS),
        (("no violation",), {"coning": replace(HINF, rho_in_bounds=False)}, ClaimVerdict.IN_PART),
        (("no violation",), {"hinf": replace(HINF, rho_in_bounds=False)}, ClaimVerdict.FAILS),
    ],
)
def test_each_verdict_follows_its_figure(words, change, verdict):
    assert one(verdicts(**change), *words) is verdict
