"""The command `gustproof fly`: one flight, new or repeated."""

import shlex
import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.laws import LAW_HELP, default_law, find_law
from gustproof.cli.options import (
    COMPILING,
    SEED,
    Anyway,
    AsJson,
    AutopilotName,
    Build,
    Params,
    VehicleName,
    complete,
    print_json,
    progress,
    refuse_given,
)

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.vehicle import Vehicle
    from gustproof.campaign.rerun import CampaignRun
    from gustproof.entries.entry import Pilot
    from gustproof.live.live import LivePage
    from gustproof.simulate.flight import Flight, FlightPlan
    from gustproof.simulate.guest import ForeignAutopilot, GuestPlan


_AUTOPILOT_OPTIONS = ("build", "params", "instance")
_TABLE_OPTIONS = (*_AUTOPILOT_OPTIONS, "autopilot", "controller", "free", "vehicle", "seed", "real_time")
_BAG_OPTIONS = (*_TABLE_OPTIONS, "scenario", "law", "run")
_Comparison = tuple[bool | None, str]
"""True if all bits are equal, `None` if they cannot be compared; the result in words."""


def fly(
    context: typer.Context,
    scenario: Annotated[
        str | None,
        typer.Argument(
            help="Name of a shipped scenario, or a .toml file.", autocompletion=complete("scenario"), show_default=False
        ),
    ] = None,
    law: Annotated[
        list[str] | None,
        typer.Option(
            help=f"{LAW_HELP} [default: flagship, tuned for a vehicle of your own]. With --view, repeat it to choose "
            "on the page.",
            autocompletion=complete("law"),
            show_default=False,
        ),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            help="Fly a controller of your own in place of a law: FILE.py:MAKER, LIBRARY.so, or 'exec: COMMAND' of a "
            "program that speaks MAVLink.",
            show_default=False,
        ),
    ] = None,
    vehicle: VehicleName = "paper",
    seed: Annotated[int, SEED] = 1,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Fly at the pace of the clock, on the usual ports.")
    ] = False,
    autopilot: AutopilotName = None,
    build: Build = "",
    params: Params = "",
    instance: Annotated[
        int | None,
        typer.Option(min=0, max=199, help="Instance of the autopilot, which sets its ports [default: a free one]."),
    ] = None,
    free: Annotated[bool, typer.Option("--free", help="Fly free, even if the scenario holds the vehicle.")] = False,
    repeat: Annotated[
        Path | None,
        typer.Option(
            help="Fly a recorded flight again from its bag alone, and compare every bit if it was in lockstep."
        ),
    ] = None,
    run: Annotated[
        str | None,
        typer.Option(help="Fly a run of a campaign again, as mc.parquet:4711, and compare its figures to the bit."),
    ] = None,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Watch the flight on a page in a browser of this machine. The page starts it, flies again and shows "
            "both; closing it ends the command.",
        ),
    ] = False,
    tlog: Annotated[bool, typer.Option(help="Write the MAVLink traffic as .tlog beside the bag.")] = True,
    anyway: Anyway = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="New folder for the recording [default: a fresh one in runs/]."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fly one scenario with autopilot and controller as two processes that speak MAVLink over UDP.

    Write a rosbag2 bag (MCAP) and the traffic (.tlog) to the output folder, and print the flight's figures.

        gustproof fly paper

        gustproof fly paper --law hinf-d1

        gustproof fly paper-turbulence --law my-law.json --seed 7 --json

        gustproof fly paper --law hinf-scheduled --real-time --view

        gustproof fly gust-roll --law pid-fair --law flagship --view

        gustproof fly --repeat runs/fly-001

        gustproof fly --run mc.parquet:4711

    With --controller an object of Python flies, or a C library of the form that export --c writes, in a process of
    its own; gustproof/guide/controllers.md tells how.

        gustproof fly paper-turbulence --controller my_mpc.py:make

        gustproof fly paper-turbulence --controller ./law.so

    A program of yours finds the vehicle's address in GUSTPROOF_ADDRESS, and in place of
    {address} in its words. It is ended with all that it started. `gustproof check-controller` tells what it does wrong.

        gustproof fly paper-turbulence --controller "exec: node mine.mjs"

    With --autopilot a real PX4, ArduPilot or Betaflight flies: it is started, armed, flown and ended here. --law then
    names a law built into it.

        gustproof fly paper-turbulence --autopilot px4 --build PX4-Autopilot/build/px4_sitl_default --params tuned
    """
    from gustproof.recording.folder import make_run_folder

    laws: list[str | None] = [*law] if law else [None]
    _refuse_several(laws, allowed=view and not any((as_json, autopilot, repeat, run)))
    table_run = _find_run(context, run, scenario, laws[0]) if run and not repeat else None
    plans: list[FlightPlan | GuestPlan]
    if table_run:
        plans = [table_run.plan]
    elif repeat:
        plans = [_load_plan(context, repeat)]
    elif autopilot:
        from gustproof.simulate.guest import ForeignAutopilot

        refuse_given(context, ("controller",), "--autopilot flies")
        chosen = ForeignAutopilot(kind=autopilot, build=build, parameters=params, law=laws[0] or "", instance=instance)
        plans = [_make_guest_plan(load_script(scenario, free=free), chosen, vehicle, seed, real_time=real_time)]
    else:
        refuse_given(context, _AUTOPILOT_OPTIONS, "without --autopilot our own flies")
        script = load_script(scenario, free=free)
        pilots = [_find_pilot(script, each, controller, vehicle, anyway=anyway, quiet=as_json) for each in laws]
        plans = _make_plans(script, pilots, seed, real_time=real_time)
    session = _Session(plans, repeat, table_run, tlog=tlog, as_json=as_json)
    session.run(make_run_folder(output, "fly"), output, view=view)


def _refuse_several(laws: Sequence[str | None], *, allowed: bool) -> None:
    if len(laws) > 1 and not allowed:
        raise ConfigError(
            "several --law need --view, and our own autopilot; or fly each, then: gustproof report RUN RUN"
        )


def _make_plans(
    script: "Scenario", pilots: "Sequence[tuple[Pilot, Vehicle]]", seed: int, *, real_time: bool
) -> "list[FlightPlan | GuestPlan]":
    from gustproof.simulate.flight import FlightPlan

    return [FlightPlan(script, pilot, vehicle, seed, real_time) for pilot, vehicle in pilots]


class _Session:
    """Flights of one command: one, or on a page one after another. The first failure becomes the exit status."""

    def __init__(
        self,
        plans: "Sequence[FlightPlan | GuestPlan]",
        repeat: Path | None,
        table_run: "CampaignRun | None",
        *,
        tlog: bool,
        as_json: bool,
    ) -> None:
        self._plans, self._repeat, self._table_run = plans, repeat, table_run
        self._tlog, self._as_json = tlog, as_json
        self._bags: list[Path] = []
        self._failure: typer.Exit | None = None

    def run(self, folder: Path, out: Path | None, *, view: bool) -> None:
        """Fly into `folder` once, or with `view` as often as the page says; then exit with the first failure."""
        if view:
            self.fly_on_page(folder, out)
        else:
            self.fly(self._plans[0], folder)
        if self._failure:
            raise self._failure

    def fly(self, plan: "FlightPlan | GuestPlan", folder: Path, page: "LivePage | None" = None) -> None:
        """Fly, print the result, and end at an interruption."""
        from gustproof.recording.folder import unless_refused
        from gustproof.simulate.outcome import FlightOutcome

        try:
            with unless_refused(folder):
                result = _fly(plan, folder, page, tlog=self._tlog, quiet=self._as_json)
        except KeyboardInterrupt:
            if not any(folder.glob("*.journal")):
                raise
            line = f"interrupted while the bag was written; restore it by gustproof recover {folder}"
            raise exit_with(line, ExitStatus.INTERRUPTED) from None
        if page:
            self._bags += [result.bag] if result.bag else []
            report = partial(_render_report, tuple(self._bags)) if self._bags else None
            page.end(result.message, result.records, _next_commands(result), report)
        interrupted = result.outcome is FlightOutcome.INTERRUPTED
        comparison = None if interrupted else _compare(result, plan, self._repeat, self._table_run)
        _print_flight(result, comparison, as_json=self._as_json)
        if interrupted:
            raise exit_with(f"interrupted; the recording so far is in {folder}", ExitStatus.INTERRUPTED)
        self._failure = self._failure or _report_failures(result, comparison, folder)

    def fly_on_page(self, folder: Path, out: Path | None) -> None:
        """Fly whenever a page says so, until no page is open; the flights after the first get folders of their own."""
        from gustproof.live.live import LivePage
        from gustproof.recording.folder import make_run_folder

        first = self._plans[0]
        names = [_pilot_name(plan) for plan in self._plans]
        with LivePage(first.scenario, names, first.vehicle, real_time=first.real_time) as page:
            print(f"gustproof: open {page.address} and press Start", file=sys.stderr, flush=True)
            import_module("gustproof.simulate.recorder")  # while the page's reader looks for Start
            self.fly(self._plans[page.wait()], folder, page)
            if self._as_json:
                return
            print("gustproof: the page can fly again; close it, or press Ctrl-C, to end", file=sys.stderr, flush=True)
            while (chosen := page.wait_again()) is not None:
                again = out and out.with_name(f"{out.name}-{1 + len(self._bags)}")
                self.fly(self._plans[chosen], make_run_folder(again, "fly"), page)


def _pilot_name(plan: "FlightPlan | GuestPlan") -> str:
    from gustproof.simulate.flight import FlightPlan

    return plan.pilot.name if isinstance(plan, FlightPlan) else plan.autopilot.name


def _render_report(bags: tuple[Path, ...]) -> str:
    from gustproof.report.html.page import render_page
    from gustproof.report.html.runs import MAX_RUNS, read_runs

    return render_page(read_runs(bags[-MAX_RUNS:]))


def _print_flight(result: "Flight", comparison: _Comparison | None, *, as_json: bool) -> None:
    from gustproof.report.terminal import render_flight, show

    if as_json:
        compared = dict(zip(("equal", "comparison"), comparison, strict=True)) if comparison else {}
        print_json(result.to_dict() | compared)
    else:
        document = (result.message, result.metrics, result.bag, result.requirements, result.timing, result.warnings)
        show(render_flight(*document, result.own_view))


def _report_failures(result: "Flight", comparison: _Comparison | None, folder: Path) -> typer.Exit | None:
    """Print how a flight compares with its original; return the exit if it differs, broke off or did not comply."""
    if comparison and comparison[0] is False:
        return exit_with(comparison[1], ExitStatus.REQUIREMENT_FAILED)
    if comparison:
        print(f"gustproof: {comparison[1]}", file=sys.stderr)
    if not result.has_expected_outcome:
        return exit_with(f"{result.message}; the recording so far is in {folder}", ExitStatus.FLIGHT_BROKE_OFF)
    failed = sum(not each.is_met for each in result.requirements)
    if failed:
        return exit_with(f"{failed} of {len(result.requirements)} requirements failed", ExitStatus.REQUIREMENT_FAILED)
    return None


def _fly(plan: "FlightPlan | GuestPlan", folder: Path, page: "LivePage | None", *, tlog: bool, quiet: bool) -> "Flight":
    """Fly with progress on standard error, and on a page if there is one."""
    from gustproof.simulate.flight import FlightPlan
    from gustproof.simulate.recorder import fly_and_record, fly_guest_and_record

    if not quiet:
        _print_warnings(plan)
    title = f"{plan.scenario.name}, {_pilot_name(plan)}"
    with progress(lambda: f"{title}{_note_compiling()}", quiet=quiet) as shown:
        writing = f"{title}: writing the bag"
        told = {"progress": lambda x: shown(x, title), "on_flown": lambda: shown(0.0, writing)}
        options: dict[str, Any] = {"tlog": tlog, **told}
        if isinstance(plan, FlightPlan):
            return fly_and_record(plan, folder, **options, on_listening=page.watch if page else None)
        return fly_guest_and_record(plan, folder, **options, on_listening=page.follow if page else None)


def _note_compiling() -> str:
    """Return the reason why a flight takes long to begin, once after an installation."""
    from gustproof.simulate.checkup import is_cold

    return COMPILING * is_cold()


def _print_warnings(plan: "FlightPlan | GuestPlan") -> None:
    from gustproof.law.form import Law
    from gustproof.simulate.flight import FlightPlan, warnings

    if isinstance(plan, FlightPlan) and isinstance(plan.pilot, Law):
        for warning in warnings(plan.scenario, plan.pilot, plan.vehicle):
            print(f"gustproof: warning: {warning}", file=sys.stderr)


def _next_commands(flight: "Flight") -> list[str]:
    """Return the commands that make a report of a flight, if it left a bag, and that fly it again."""
    report = shlex.join(["gustproof", "report", str(flight.bag), "-o", "report.html"])
    again = shlex.join(["gustproof", *sys.argv[1:]])  # refused where it would write over this flight
    return [report, again] if flight.bag else [again]


def load_script(scenario: str | None, *, free: bool) -> "Scenario":
    """Return the scenario, in free flight if `free`; its name then says so."""
    from dataclasses import replace

    from firmware_model.config.scenario import load_scenario

    if scenario is None:
        raise ConfigError("give a scenario, or --repeat, or --run")
    script = load_scenario(scenario)
    return replace(script, name=f"{script.name}-free", translation="free") if free and not script.free else script


def _make_guest_plan(
    script: "Scenario", autopilot: "ForeignAutopilot", vehicle: str, seed: int, *, real_time: bool
) -> "GuestPlan":
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.simulate.guest import GuestPlan

    return GuestPlan(script, autopilot, load_vehicle(vehicle), seed, real_time or not autopilot.has_lockstep)


def _find_pilot(
    script: "Scenario", law: str | None, controller: str | None, vehicle: str, *, anyway: bool, quiet: bool
) -> "tuple[Pilot, Vehicle]":
    """Return law or controller, by default a law for the vehicle, and the vehicle; refuse what should not begin."""
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.entries.entry import parse_entry
    from gustproof.simulate.flight import check

    if controller is not None and law is not None:
        raise ConfigError("--controller flies in place of a law; --law cannot be given with it")
    vehicles = load_vehicle_set(vehicle)
    flown: Pilot
    if controller is not None:
        flown = parse_entry(controller)
    elif law is None:
        flown = default_law(vehicles, script, quiet=quiet)
    else:
        flown = find_law(law, vehicles.nominal, script.control_rate_hz)
    if not anyway:
        check(script, flown, vehicles.nominal)
    return flown, vehicles.nominal


def _load_plan(context: typer.Context, run: Path) -> "FlightPlan | GuestPlan":
    from gustproof.recording.bag import read_bag
    from gustproof.recording.folder import find_bag
    from gustproof.simulate.flight import parse_plan
    from gustproof.simulate.guest import parse_guest_plan

    refuse_given(context, _BAG_OPTIONS, "--repeat flies the plan in the bag")
    bag = find_bag(run)
    about, _ = read_bag(bag)
    return parse_guest_plan(about, bag) if about.get("autopilot") else parse_plan(about, bag)


def _find_run(context: typer.Context, run: str, scenario: str | None, law: str | None) -> "CampaignRun":
    from gustproof.campaign.rerun import find_run

    refuse_given(context, _TABLE_OPTIONS, "--run flies the plan in the table")
    found = find_run(run)
    found.check(scenario, law)
    return found


def _compare(
    result: "Flight", plan: "FlightPlan | GuestPlan", repeat: Path | None, table_run: "CampaignRun | None"
) -> _Comparison | None:
    """Compare every bit of a flight with the one that it repeats; `None` if it repeats none."""
    from gustproof.recording.bag import read_bag
    from gustproof.recording.folder import find_bag
    from gustproof.simulate.flight import first_difference_s

    if table_run:
        name = f"run {table_run.row['run']} of {table_run.table}"
        if table_run.row["failure"] is not None:
            return None, f"{name} left no figures: not compared"
        if differences := table_run.differences(result):
            return False, f"differs from {name} in {', '.join(differences)}"
        return True, f"equal to {name} in every bit of its figures"
    if repeat is None:
        return None
    if plan.real_time:
        return None, f"{repeat} was flown in real time, where no two flights share all bits: not compared"
    about, records = read_bag(find_bag(repeat))
    begin_s = first_difference_s(result.records, records)
    if begin_s is None:
        return True, f"equal to {repeat} in every bit of its {len(records)} samples"
    line = f"differs from {repeat} from {begin_s:.3f} s on, which ended as '{about['outcome']}'"
    return False, f"{line}; {_reason_to_differ(about)}"


def _reason_to_differ(about: dict[str, Any]) -> str:
    """Return what may have changed the bits of a flight that is flown again, by what its bag tells."""
    from gustproof.version import software_versions

    then, now = about["versions"], software_versions()
    changed = [f"{name} {then[name]}, now {now.get(name)}" for name in then if then[name] != now.get(name)]
    if changed:
        return f"it was flown with {', '.join(changed)}"
    if about.get("controller"):
        return "a controller of one's own need not fly the same twice"
    if (about.get("autopilot") or {}).get("autopilot") == "px4":
        return "PX4 arms on a thread of its own, up to a sample later, and from then on no two flights are equal"
    return "the versions are the same"
