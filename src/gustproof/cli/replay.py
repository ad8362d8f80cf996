"""The command `gustproof replay`: a recorded flight, flown again and compared."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gustproof.cli.flights import (
    Comparison,
    NewFolder,
    NoTlog,
    Same,
    Session,
    View,
    choose_autopilot,
    complete_recordings,
    confirm_flown,
)
from gustproof.cli.options import AsJson, AutopilotName, Build, Params

if TYPE_CHECKING:
    from gustproof.flight.routes.flight import Flight, FlightPlan


def replay(
    context: typer.Context,
    run: Annotated[Path, typer.Argument(help="Output folder of a flight, or its bag.", show_default=False)],
    controller: Same = None,
    autopilot: AutopilotName = None,
    build: Build = "",
    params: Params = "",
    view: View = False,
    no_tlog: NoTlog = False,
    output: NewFolder = None,
    as_json: AsJson = False,
) -> None:
    """Fly a recorded flight again from its bag alone, and compare every bit if it was in lockstep.

    A bag starts no program: name what is no law again, by --controller, or --autopilot and --build. A flight that was
    cut off is completed from its journal first. Exit status: 0 equal, 1 it differs.

        gustproof replay runs/fly-001
        gustproof replay runs/fly-002 --controller my_mpc.py:make
    """
    chosen = choose_autopilot(context, autopilot, build, params)
    complete_recordings(run, quiet=as_json)
    plan = confirm_flown(_load_plan(run), controller, chosen, run)
    Session([plan], partial(_compare, run, plan), tlog=not no_tlog, as_json=as_json).run(output, view=view)


def _load_plan(run: Path) -> "FlightPlan":
    from gustproof.flight.recording.bag import read_flight
    from gustproof.flight.recording.folder import find_bag
    from gustproof.flight.routes.flight import parse_plan

    bag = find_bag(run)
    return parse_plan(read_flight(bag), bag)


def _compare(run: Path, plan: "FlightPlan", result: "Flight") -> Comparison:
    """Compare every bit of a flight with the recorded one."""
    from gustproof.flight.recording.bag import read_flight
    from gustproof.flight.recording.difference import first_difference
    from gustproof.flight.recording.folder import find_bag

    if plan.real_time:
        return None, f"{run} was flown in real time, where no two flights share all bits: not compared"
    bag = find_bag(run)
    begin, samples = first_difference(bag, result.records)
    if begin is None:
        return True, f"equal to {run} in every bit of its {samples} samples"
    about, begin_s = read_flight(bag), result.records["time_us"][begin] * 1e-6
    line = f"differs from {run} from {begin_s:.3f} s on, which ended as '{about['outcome']}'"
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
