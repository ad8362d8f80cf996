"""Flights of a command: one, or on a page one after another; and what a recorded one needs to be flown again."""

import os
import shlex
import sys
import webbrowser
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.laws import warn_of_repeated
from gustproof.cli.options import COMPILING, print_json, print_next, progress, refuse_given, working

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
    from gustproof.flight.routes.flight import Flight, FlightPlan
    from gustproof.show.live.live import LivePage

Comparison = tuple[bool | None, str]
"""True if all bits are equal, `None` if they cannot be compared; the result in words."""
View = Annotated[
    bool,
    typer.Option(
        "--view",
        help="Watch on a page in the browser, which can fly again.",
    ),
]
NoTlog = Annotated[bool, typer.Option("--no-tlog", help="Write no .tlog of the MAVLink traffic beside the bag.")]
NewFolder = Annotated[
    Path | None,
    typer.Option("-o", "--output", help="New folder of the recording [default: in runs/]."),
]
Same = Annotated[
    str | None,
    typer.Option(
        "--controller", help="The controller of your own that flew: no recording starts one.", show_default=False
    ),
]
FLIGHT_FILES = (".xml", ".ulg")
"""Endings of files that a flight can be written to beside its recording."""
_COMPILING_S = 15  # on two cores of 2024
_AUTOPILOT_OPTIONS = ("build", "params", "instance")


class Session:
    """Flights of one command: one, or on a page one after another. The first failure becomes the exit status."""

    def __init__(
        self,
        plans: "Sequence[FlightPlan]",
        compare: "Callable[[Flight], Comparison] | None" = None,
        *,
        tlog: bool,
        as_json: bool,
        files: Sequence[Path] = (),
    ) -> None:
        """Take what flies, what compares each flight with the one that it repeats, and `files` to write of a flight."""
        self._files = files
        self._plans, self._compare, self._tlog, self._as_json = plans, compare, tlog, as_json
        self._bags: list[Path] = []
        self._failure: typer.Exit | None = None

    def run(self, out: Path | None, *, view: bool) -> None:
        """Fly into the new folder `out` once, or with `view` as often as the page says.

        Raises
        ------
        typer.Exit
            With the first failure.
        """
        from gustproof.flight.recording.folder import run_folder

        with run_folder(out, "fly") as folder:
            if view:
                self.fly_on_page(folder, out)
            else:
                self.fly(self._plans[0], folder)
        if self._failure:
            raise self._failure

    def fly(self, plan: "FlightPlan", folder: Path, page: "LivePage | None" = None) -> None:
        """Fly, print the result, and end at an interruption."""
        from gustproof.flight.routes.outcome import FlightOutcome

        try:
            result = _fly(plan, folder, page, tlog=self._tlog, quiet=self._as_json)
        except KeyboardInterrupt:
            if not any(folder.glob("*.journal")):
                raise
            line = f"interrupted while the bag was written; gustproof report {folder} completes it"
            raise exit_with(line, ExitStatus.INTERRUPTED) from None
        if page:
            self._bags += [result.bag] if result.bag else []
            report = partial(_render_report, tuple(self._bags)) if self._bags else None
            page.end(result.message, result.records, _next_commands(result), report)
        interrupted = result.outcome is FlightOutcome.INTERRUPTED
        comparison = None if interrupted or self._compare is None else self._compare(result)
        _print_flight(result, comparison, as_json=self._as_json)
        if interrupted:
            raise exit_with(f"interrupted; {_say_kept(result, folder)}", ExitStatus.INTERRUPTED)
        for path in self._files:
            _write_file(path, result)
        self._failure = self._failure or _report_failures(result, comparison, folder)

    def fly_on_page(self, folder: Path, out: Path | None) -> None:
        """Fly whenever a page says so, until no page is open; the flights after the first get folders of their own."""
        from gustproof.flight.recording.folder import run_folder
        from gustproof.show.live.live import LivePage

        first = self._plans[0]
        controllers, paced = [plan.controller for plan in self._plans], first.real_time
        with LivePage(first.scenario, controllers, first.vehicle, real_time=paced) as page:
            print(f"gustproof: open {page.address} and press Start", file=sys.stderr, flush=True)
            _open_page(page.address)
            import_module("gustproof.flight.routes.recorder")  # while the page's reader looks for Start
            _compile(page, quiet=self._as_json)
            self.fly(self._plans[page.wait()], folder, page)
            if self._as_json:
                return
            print("gustproof: the page can fly again; close it, or press Ctrl-C, to end", file=sys.stderr, flush=True)
            while (chosen := page.wait_again()) is not None:
                again = out and out.with_name(f"{out.name}-{1 + len(self._bags)}")
                with run_folder(again, "fly") as folder:
                    self.fly(self._plans[chosen], folder, page)


def _open_page(address: str) -> None:
    """Open the page in a browser, where there is a screen; a browser of text would take the terminal."""
    if sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")):
        webbrowser.open(address)


def _compile(page: "LivePage", *, quiet: bool) -> None:
    """Compile the simulator by a short flight while a user reads the page; once after an installation."""
    from dataclasses import replace

    from firmware_model.config.scenario import load_scenario
    from gustproof.flight.routes.checkup import is_cold
    from gustproof.flight.routes.processes import fly
    from gustproof.law.form import load_law

    if is_cold():
        page.tell_compiling(_COMPILING_S)
        with working("compiling the simulator, once", quiet=quiet):
            fly(replace(load_scenario("calm"), duration_s=0.1), load_law("flagship"))
        page.tell_compiling(0)


def _write_file(path: Path, flight: "Flight") -> None:
    """Write a flight's requirements as JUnit, or its samples as ULog."""
    from firmware_model.config.files import write_text
    from gustproof.flight.recording.px4_log import write_ulog
    from gustproof.show.report.junit import flight_tests, render_suites

    if path.suffix == ".xml":
        title = f"{flight.scenario.name} on {flight.vehicle.name}, seed {flight.seed}"
        write_text(path, render_suites({title: [*flight_tests(flight)]}))
    elif len(flight.records):
        about = {"scenario": flight.scenario.name, "controller": flight.pilot_name, "seed": str(flight.seed)}
        write_ulog(path, flight.records, flight.vehicle, flight.scenario, about, flight.estimates)


def _render_report(bags: tuple[Path, ...]) -> str:
    from gustproof.show.report.html.page import render_page
    from gustproof.show.report.html.runs import MAX_RUNS, read_runs

    return render_page(read_runs(bags[-MAX_RUNS:]))


def _print_flight(result: "Flight", comparison: Comparison | None, *, as_json: bool) -> None:
    from gustproof.show.report.terminal import render_flight, show

    if as_json:
        compared = dict(zip(("equal", "comparison"), comparison, strict=True)) if comparison else {}
        print_json(result.to_dict() | compared)
    else:
        show(render_flight(result))
        if result.bag:
            print_next("report", result.bag, "-o", "report.html")


def _say_kept(result: "Flight", folder: Path) -> str:
    """Return what is left of a flight that broke off: a folder alone is no recording."""
    return f"the recording so far is in {folder}" if result.bag else "nothing was flown, and no recording is left"


def _report_failures(result: "Flight", comparison: Comparison | None, folder: Path) -> typer.Exit | None:
    """Print how a flight compares with its original; return the exit if it differs, broke off or did not comply."""
    if comparison and comparison[0] is False:
        return exit_with(comparison[1], ExitStatus.REQUIREMENT_FAILED)
    if comparison:
        print(f"gustproof: {comparison[1]}", file=sys.stderr)
    if not result.has_expected_outcome:
        return exit_with(f"{result.message}; {_say_kept(result, folder)}", ExitStatus.FLIGHT_BROKE_OFF)
    failed = sum(not each.is_met for each in result.requirements)
    if failed:
        return exit_with(f"{failed} of {len(result.requirements)} requirements failed", ExitStatus.REQUIREMENT_FAILED)
    return None


def _fly(plan: "FlightPlan", folder: Path, page: "LivePage | None", *, tlog: bool, quiet: bool) -> "Flight":
    """Fly with progress on standard error, and on a page if there is one."""
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
    from gustproof.flight.routes.recorder import fly_and_record

    if not quiet:
        _print_warnings(plan)
        _print_temporary_cache()
    title = f"{plan.scenario.name}, {plan.controller.name}"
    beginning = cache(lambda: f"{title}{_note_compiling()}")
    at_once = isinstance(plan.controller, ExternalAutopilot)
    with progress(beginning, quiet=quiet, at_once=at_once) as shown:
        return fly_and_record(
            plan,
            folder,
            tlog=tlog,
            progress=lambda x: shown(x, title if x or quiet else beginning()),
            on_flown=lambda: shown(0.0, f"{title}: writing the bag"),
            on_listening=page.watch if page else None,
        )


def _note_compiling() -> str:
    """Return the reason why a flight takes long to begin, once after an installation."""
    from gustproof.flight.routes.checkup import is_cold

    return COMPILING * is_cold()


def _print_temporary_cache() -> None:
    from gustproof.flight.routes.checkup import describe_temporary_cache

    if line := describe_temporary_cache():
        print(f"gustproof: {line}", file=sys.stderr)


def _print_warnings(plan: "FlightPlan") -> None:
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
    from gustproof.flight.routes.flight import warnings
    from gustproof.law.form import Law

    if isinstance(plan.controller, ExternalAutopilot):
        tell_rate(plan.scenario, plan.controller.kind)
    elif isinstance(plan.controller, Law):
        for warning in warnings(plan.scenario, plan.controller, plan.vehicle, plan.nominal):
            print(f"gustproof: warning: {warning}", file=sys.stderr)


def tell_rate(script: "Scenario", kind: str) -> None:
    """Say on stderr at which rate a kind of real autopilot flies a scenario, if not at that of the script."""
    from gustproof.flight.routes.external import describe_rate

    if rate := describe_rate(script, kind):
        print(f"gustproof: {rate}", file=sys.stderr)


def _next_commands(flight: "Flight") -> list[str]:
    """Return the commands that make a report of a flight, if it left a bag, and that fly it again."""
    report = shlex.join(["gustproof", "report", str(flight.bag), "-o", "report.html"])
    again = shlex.join(["gustproof", *sys.argv[1:]])  # refused where it would write over this flight
    return [report, again] if flight.bag else [again]


def complete_recordings(run: Path, *, quiet: bool = False) -> None:
    """Write the bags of flights in a folder that were cut off, from their journals; print the figures of each.

    Raises
    ------
    ConfigError
        If a journal is damaged, or its flight is not over.
    FlightError
        If a bag can't be written.
    """
    if not any(run.glob("*.journal")):
        return
    from gustproof.flight.routes.recorder import recover
    from gustproof.show.report.terminal import render_flight, show

    with working(f"completing {run}", quiet=quiet):
        flights = recover(run)
    for flight in () if quiet else flights:
        show(render_flight(flight))


def choose_autopilot(
    context: typer.Context,
    kind: str | None,
    build: str,
    params: str,
    law: str | None = None,
    instance: int | None = None,
) -> "ExternalAutopilot | None":
    """Return the real autopilot on the command line; `None` for our own, which takes none of its options."""
    if kind is None:
        refuse_given(context, _AUTOPILOT_OPTIONS, "without --autopilot our own flies")
        return None
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot

    refuse_given(context, ("controller",), "--autopilot flies")
    warn_of_repeated([params], kind)
    return ExternalAutopilot(kind=kind, build=build, parameters=params, law=law or "", instance=instance)


def confirm_flown(
    plan: "FlightPlan", controller: str | None, autopilot: "ExternalAutopilot | None", where: Path
) -> "FlightPlan":
    """Return the plan of a bag or a table, to be flown by what the command line names if that is no law.

    Raises
    ------
    ConfigError
        If the command line does not name it, or names another.
    """
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot, confirm_autopilot
    from gustproof.flight.controllers.user_controller import ControllerKind, UserController, confirm_controller

    flown = plan.controller
    for given, option, kind in (
        (controller, "--controller", UserController),
        (autopilot, "--autopilot", ExternalAutopilot),
    ):
        if given is not None and not isinstance(flown, kind):
            raise ConfigError(f"{where}: flown by '{flown.name}', not by {option}")
    if isinstance(flown, ExternalAutopilot):
        return plan._replace(controller=confirm_autopilot(flown, autopilot, where))
    if not isinstance(flown, UserController):
        return plan
    confirmed = confirm_controller(flown, controller, where)
    identity = (
        f"its SHA-256 {confirmed.digest[:16]}…" if confirmed.kind is not ControllerKind.PROGRAM else "its command"
    )
    print(f"gustproof: controller '{confirmed.name}' is the one that flew, by {identity}", file=sys.stderr)
    return plan._replace(controller=confirmed)
