"""Flights of the paper over UDP with every scenario, law and seed, with figures and verdicts."""

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Event
from typing import Any

from rich.console import Group
from rich.text import Text

from firmware_model.config.files import write_text
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import Dryden
from gustproof.airframe.lpv import RATE_BOUND
from gustproof.airframe.rotational import Envelope, paper_rotation
from gustproof.design.derive import DesignReport, derive
from gustproof.design.designs import load_design
from gustproof.design.tune import default_slew, tune_law
from gustproof.errors import FlightError
from gustproof.flight.routes.flight import Flight, FlightPlan, objection, warnings
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.recorder import fly_and_record
from gustproof.flight.scoring.metrics import Metrics, median_metrics, peak_rate
from gustproof.law.form import Law, load_law
from gustproof.robust.uncertain.interconnection import Interconnection
from gustproof.show.report.terminal import Renderable, save_text
from gustproof.show.reproduce.claims import PAPER_LAWS, PaperClaim, judge_claims
from gustproof.show.reproduce.paper_tables import render_reproduction
from gustproof.studies.rate.law_margins import SPREADS, HoverMargins, axis_robustness, hover_margins
from gustproof.studies.rate.placement import SLEW, ErrorLimits, Places, performance_limits

_BEFORE, _AFTER = 0.15, 0.9  # shares of the work that are done when the flights begin and end
SCENARIOS = ("paper", "paper-turbulence", "coning", "bias")
_CASCADES = ("pid-default", "pid-fair", "indi", "flagship", "flagship-robust", "aided")
LAWS = (*_CASCADES, "hinf-d1", "hinf-d1-noise", "hinf-d2", "hinf-scheduled", "hinf-rates")
_TUNED = ("flagship", "pid", "indi")
"""Cascades that are tuned for a vehicle other than `paper`."""
_PAPER = "paper"
_NOT_COMPARED = "hinf-d1-noise"
"""Law with a frequency weight, flown once."""
_PARALLEL_FLIGHTS = 2
"""Flights side by side. The two processes of a lockstep flight take turns and keep one core busy."""

Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reproduction:
    """Results of the reproduction."""

    vehicle: Vehicle
    """Vehicle of all flights."""
    laws: Mapping[str, Law]
    """Laws by name."""
    seeds: tuple[int, ...]
    """Seeds of gusts and noise."""
    medians: Mapping[str, Mapping[str, Metrics]]
    """Figures by law and scenario, medians over the seeds."""
    margins: Mapping[str, HoverMargins | None]
    """Margins at hover by law."""
    stability_factor: Mapping[str, float | None]
    """[-] multiple of `SPREADS` of inertia and lag that is certified stable at hover, by law; `None` if unknown."""
    limits: ErrorLimits
    """Least possible errors in the turbulence."""
    places: Places
    """Distance of each law from them."""
    claims: tuple[PaperClaim, ...]
    """Verdicts on the paper's claims."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the laws on this vehicle, a line each."""
        scenario = load_scenario("paper")
        return tuple(line for law in self.laws.values() for line in warnings(scenario, law, self.vehicle))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `summary.json`."""
        return {
            "laws": {
                law: {
                    **{name: asdict(metrics) for name, metrics in scenarios.items()},
                    "seeds": list(self.seeds[:1] if law == _NOT_COMPARED else self.seeds),
                    "place": None if (place := self.places[law]) is None else asdict(place),
                    "margins": None if (margins := self.margins[law]) is None else asdict(margins),
                    "certified_up_to_times": self.stability_factor[law],
                }
                for law, scenarios in self.medians.items()
            },
            "warnings": list(self.warnings),
            "spreads": asdict(SPREADS),
            "limits": asdict(self.limits),
            "claims": [{**claim._asdict(), "verdict": claim.verdict.value} for claim in self.claims],
        }

    def render(self) -> Renderable:
        """Return the report as tables and text."""
        document = render_reproduction(
            self.medians, self.margins, self.limits, self.places, self.claims, self.vehicle, load_scenario("paper")
        )
        tuned = [law.name for law in self.laws.values() if law.provenance.fits(self.vehicle)]
        missing = [name for name in LAWS if name not in self.laws]
        lines = [f"made for '{self.vehicle.name}': {', '.join(tuned)}"]
        if missing:
            lines.append(f"unstable on '{self.vehicle.name}' and not flown: {', '.join(missing)}")
        return Group(*(Text(line) for line in (*lines, *(f"warning: {line}" for line in self.warnings))), document)


def find_laws(vehicles: VehicleSet, *, anyway: bool, progress: Progress) -> dict[str, Law]:
    """Return the laws to fly by name: the shipped ones on their vehicle `paper`.

    On another vehicle they are cascades tuned for it, and those of the shipped ones that are stable there, all with
    `anyway`.

    Raises
    ------
    DesignError
        If no cascade can be tuned.
    """
    vehicle, shipped = vehicles.nominal, {name: load_law(name) for name in LAWS}
    scenarios = [load_scenario(name) for name in SCENARIOS]
    if not anyway:
        shipped = {
            name: law
            for name, law in shipped.items()
            if not any(objection(scenario, law, vehicle) for scenario in scenarios)
        }
    if vehicle.name == _PAPER:
        return shipped
    air = load_scenario("paper-turbulence")
    tuned = [tune_law(kind, vehicles, air, progress=lambda share, text: progress(0.0, text)).law for kind in _TUNED]
    return {**{law.name: law for law in tuned}, **shipped}


def reproduce(
    vehicle: Vehicle, seeds: Sequence[int], out: Path, progress: Progress, laws: Mapping[str, Law] | None = None
) -> Reproduction:
    """Fly all cases, write bags, laws, figures and `summary.json` to the empty folder `out`, and judge the claims.

    `laws` default to the shipped ones. Without those that the claims are about, none is judged.

    Raises
    ------
    ConfigError
        If a law or scenario is unreadable.
    FlightError
        If a flight did not reach its end.
    """
    laws = {name: load_law(name) for name in LAWS} if laws is None else laws
    scenarios = {name: load_scenario(name) for name in SCENARIOS}
    (out / "laws").mkdir()
    for law in laws.values():
        law.save(out / "laws" / f"{law.name}.json")
    margins, robust = {}, {}
    for i, (name, law) in enumerate(laws.items()):
        progress(_BEFORE * i / len(laws), f"margins of {name}")
        margins[name] = hover_margins(law, vehicle, scenarios["paper"])
        robust[name] = axis_robustness(law, vehicle, scenarios["paper"])
    stability_factor = {name: min(x.certified for x in axes) if axes else None for name, axes in robust.items()}
    air = scenarios["paper-turbulence"]
    slew = SLEW if vehicle.name == _PAPER else default_slew(vehicle, air)
    progress(_BEFORE, "performance limits")
    limits, places = performance_limits(laws, margins, vehicle, air, slew)
    plans = [
        FlightPlan(scenario, law, vehicle, seed, real_time=False)
        for scenario in scenarios.values()
        for law in laws.values()
        for seed in _select_seeds(law.name, seeds, scenario)
    ]
    flights = _fly_all(plans, out / "bags", lambda share, name: progress(_BEFORE + share * (_AFTER - _BEFORE), name))
    progress(_AFTER, "figures and verdicts")
    medians = {law: {scenario: _median_of(flights, scenario, law) for scenario in scenarios} for law in laws}
    _, solved = derive(load_design("D1"), vehicle)
    reproduction = Reproduction(
        vehicle=vehicle,
        laws=laws,
        seeds=tuple(seeds),
        medians=medians,
        margins=margins,
        stability_factor=stability_factor,
        limits=limits,
        places=places,
        claims=_judge_claims(medians, laws, flights, solved),
    )
    write_text(out / "summary.json", json.dumps(reproduction.to_dict(), indent=2) + "\n")
    _draw(reproduction, flights, solved.problem, out / "figures")
    save_text(reproduction.render(), out / "report.txt")
    progress(1.0, "written")
    return reproduction


def _judge_claims(
    medians: Mapping[str, Mapping[str, Metrics]],
    laws: Mapping[str, Law],
    flights: Sequence[Flight],
    solved: DesignReport,
) -> tuple[PaperClaim, ...]:
    """Return the verdicts; none if a law that the claims are about was not flown."""
    if not {*PAPER_LAWS, "pid-fair"} <= set(laws) or solved.gamma_opt is None:
        return ()
    highest = max(peak_rate(flight.records) for flight in flights if flight.matches("paper", "hinf-d1"))
    figures = {"norm": solved.result.norm, "gamma_opt": solved.gamma_opt}
    return judge_claims(medians, laws, peak_rate=highest, **figures)


def _fly_all(plans: Sequence[FlightPlan], out: Path, progress: Progress) -> list[Flight]:
    """Return the flights of `plans`, flown side by side. The first failure ends the others."""
    out.mkdir()
    shares, stop = [0.0] * len(plans), Event()

    def fly(index: int, plan: FlightPlan) -> Flight:
        name = f"{plan.scenario.name}, {plan.controller.name}, seed {plan.seed}"

        def show(share: float) -> None:
            if stop.is_set():
                raise KeyboardInterrupt  # ends the flight's processes in order
            shares[index] = share
            progress(sum(shares) / len(shares), name)

        flight = fly_and_record(plan, out, progress=show)
        if flight.outcome is not FlightOutcome.DONE:
            raise FlightError(flight.message)
        return flight

    with ThreadPoolExecutor(_PARALLEL_FLIGHTS) as pool:
        futures = [pool.submit(fly, index, plan) for index, plan in enumerate(plans)]
        try:
            return [future.result() for future in futures]
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _draw(found: Reproduction, flights: Sequence[Flight], problem: Interconnection, out: Path) -> None:
    """Draw the paper's figures for one seed: its two laws in its flight, all laws but the first in turbulence."""
    from gustproof.show.report import diagrams, figures

    seed = found.seeds[0]
    out.mkdir()
    laws = list(found.laws)[found.vehicle.name == _PAPER :]
    paper = list(PAPER_LAWS) if set(PAPER_LAWS) <= set(laws) | {"pid-default"} else laws[:1]
    lead = "hinf-d1" if "hinf-d1" in laws else laws[0]
    for scenario, names in (("paper", paper), ("paper-turbulence", laws)):
        records = {
            name: f.records for f in flights for name in found.laws if f.matches(scenario, name) and f.seed == seed
        }
        shown = {name: records[name] for name in names}
        figures.save_moments(records[lead], out / f"{scenario}-moments.png")
        for history in figures.HISTORIES:
            figures.save_histories(history, shown, scenario, out / f"{scenario}-{history}.png")
        figures.save_scheduling(records[lead], lead, out / f"{scenario}-scheduling.png")
    diagrams.save_interconnection(problem, "Interconnection of design D1", out / "interconnection.png")
    # Delta has the same blocks in every envelope.
    dynamics = paper_rotation(found.vehicle.inertia_B, Envelope(angle=0.5, rate=RATE_BOUND))
    title = f"LFT of the closed loop, Delta of order {dynamics.n_z}"
    diagrams.save_lft(problem, dynamics, title, out / "lft.png")
    flown = {law: scenarios["paper-turbulence"] for law, scenarios in found.medians.items()}
    figures.save_trade_off(found.limits, found.places, flown, out / "trade-off.png")


def _median_of(flights: Sequence[Flight], scenario: str, law: str) -> Metrics:
    return median_metrics([f.metrics for f in flights if f.matches(scenario, law) and f.metrics is not None])


def _select_seeds(law: str, seeds: Sequence[int], scenario: Scenario) -> Sequence[int]:
    """Return the seeds of a law: one if it changes nothing, or if the law is not compared."""
    noisy = scenario.gyro.noise or scenario.accelerometer.noise
    random = noisy or any(isinstance(item, Dryden) for item in scenario.wind)
    return seeds if random and law != _NOT_COMPARED else seeds[:1]
