"""Derive the shipped laws again: `python -m gustproof.design.shipped` writes their files.

The rate commanded from attitude is limited to `rate_limit` of the vehicle's own loops, 3 rad/s for `paper`. With 2, 3
and 4 rad/s every law with the limit recovered from each kick flown to 20 N*m and held each step to 70/40 deg. With
6 rad/s `aided` and `hinf-reference` lost kicks, `indi` and `hinf-reference` steps. A step of the flagship to 70 deg
overshot by 34 deg with 4 rad/s, by 12 with 3.
"""

from collections.abc import Callable

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.design.cascades.autotune import autotune_pid
from gustproof.design.cascades.flagship import ROBUST_LIMITS, flagship_law
from gustproof.design.cascades.indi import indi_law
from gustproof.design.cascades.pid_baseline import baseline_pid
from gustproof.design.derive import derive
from gustproof.design.designs import list_designs, load_design
from gustproof.law.form import LAWS, Law

PAPER_BANDWIDTH = 0.8
"""[rad/s] target bandwidth of the paper's PID, not stated in the paper. Chosen once: near the autotuner's default of
1 rad/s. With design D1 on the scenario `paper` it comes near all four numbers of Table III."""


def _make_derivation(name: str) -> Callable[[], Law]:
    return lambda: derive(load_design(name))[0]


DERIVATIONS: dict[str, Callable[[], Law]] = {
    "pid-default": lambda: autotune_pid(load_vehicle("paper"), bandwidth=PAPER_BANDWIDTH),
    "pid-fair": lambda: baseline_pid(load_vehicle("paper"), load_scenario("paper-turbulence")),
    "flagship": lambda: flagship_law(load_vehicle("paper"), load_scenario("paper-turbulence")),
    "flagship-robust": lambda: flagship_law(
        load_vehicle("paper"), load_scenario("paper-turbulence"), name="flagship-robust", limits=ROBUST_LIMITS
    ),
    "indi": lambda: indi_law(load_vehicle("paper"), load_scenario("paper-turbulence")),
    **{load_design(name).law: _make_derivation(name) for name in list_designs()},
}
"""Derivation of each shipped law, by its name."""


def main() -> None:
    """Write every shipped law."""
    for name, make in DERIVATIONS.items():
        make().save(LAWS / f"{name}.json")


if __name__ == "__main__":
    main()
