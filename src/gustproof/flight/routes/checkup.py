"""Checkup of an installation: versions, folder, ports, compile cache, real-time rights, autopilots, one test flight."""

import os
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from enum import Enum
from functools import partial
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.external.versions import doubt_version, read_version
from firmware_model.numerics.compiled import find_cache
from firmware_model.numerics.kept_code import find_damaged
from firmware_model.process import realtime, udp
from firmware_model.sim.step import advance
from firmware_model.sim.vehicle_loop import is_cold as is_cold
from gustproof.flight.controllers.external_autopilot import AUTOPILOTS
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.external import find_build
from gustproof.flight.routes.flight import FlightPlan, first_difference_s
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.processes import fly_plan
from gustproof.law.form import load_law
from gustproof.version import software_versions

_PORTS = {
    18570: "the simulated autopilot listens here for ground stations",
    14580: "the simulated autopilot listens here for off-board programs",
    14550: "ground stations listen here",
    14540: "off-board programs listen here",
}
_OWN_PORTS = (18570, 14580)
_FREE_DISK = 1 << 30  # [bytes] a flight of a minute takes 10 MB, a campaign a hundred
_TEST_S = 2.0
_FINDERS = {kind: partial(find_build, kind) for kind in AUTOPILOTS}


class Status(Enum):
    """Result of one check."""

    OK = "OK"
    ABSENT = "absent"  # not there, and needed by one option alone
    WARNING = "warning"  # flights work; something is slower, or one command is missing
    FAULT = "fault"  # flights do not work


class Check(NamedTuple):
    """One check of an installation."""

    name: str
    """Subject."""
    status: Status
    """Result."""
    found: str
    """Finding in one line."""
    advice: str = ""
    """Remedy in one line; empty if none is needed."""


def check_versions() -> Check:
    """Check that each package is there and not older than gustproof requires."""
    found = ", ".join(f"{name} {number}" for name, number in software_versions().items())
    old = [line for line in requires("gustproof") or () if "extra ==" not in line and not _is_met(line)]
    if old:
        return Check("versions", Status.FAULT, found, f"pip install --upgrade {' '.join(map(repr, old))}")
    return Check("versions", Status.OK, found)


def _is_met(requirement: str) -> bool:
    """Return whether a requirement `name>=1.2` is met by what is installed."""
    parts = re.match(r"([\w.-]+)>=([\d.]+)", requirement)
    if parts is None:
        return True
    try:
        installed = version(parts[1])
    except PackageNotFoundError:
        return False
    return _numbers(installed) >= _numbers(parts[2])


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text)[:3])


def check_folder(folder: Path) -> Check:
    """Check that recordings can be written to a folder."""
    if not os.access(folder, os.W_OK):
        return Check("folder", Status.WARNING, f"{folder}: not writable", "start elsewhere, or give --output")
    free = shutil.disk_usage(folder).free
    found = f"{folder}: writable, {free / 1e9:.1f} GB free"
    if free < _FREE_DISK:
        return Check("folder", Status.WARNING, found, "free some space: a campaign takes a hundred MB")
    return Check("folder", Status.OK, found)


def _check_current_folder() -> Check:
    try:
        return check_folder(Path.cwd())
    except FileNotFoundError:
        return Check("folder", Status.WARNING, "the current folder is gone", "start elsewhere")


def check_port(port: int) -> Check:
    """Check that a UDP port is free, or taken by the kind of program that it is for."""
    name, use = f"port {port}", _PORTS[port]
    try:
        with closing(udp.bind(port)):
            return Check(name, Status.OK, f"free; {use}")
    except ConfigError:
        if port not in _OWN_PORTS:
            return Check(name, Status.OK, f"taken; {use}, and one does")
        advice = "end the other autopilot, or give `gustproof autopilot` --instance 1 or --bind-port"
        return Check(name, Status.WARNING, f"taken; {use}", advice)


def check_cache() -> Check:
    """Check that machine code is kept between commands, and is there for these sources."""
    found, lasting = find_cache(advance), "set NUMBA_CACHE_DIR to a folder that you can write to"
    if found is None:
        advice = f"unset NUMBA_DISABLE_JIT, or {lasting}"
        missing = "none: each command compiles anew, or runs a hundred times slower"
        return Check("compile cache", Status.WARNING, missing, advice)
    folder = found.folder
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        return Check("compile cache", Status.WARNING, f"{folder}: not writable", lasting)
    if damaged := find_damaged():
        text = f"{damaged[0]}: damaged, or written by others; is not used" + f", one of {len(damaged)}"
        return Check("compile cache", Status.WARNING, text, "nothing, the next flight compiles it again")
    state = "warm" if found.warm else "cold, so the first flight compiles"
    if found.temporary:
        text = f"{folder}: temporary, as neither the installation nor the home can be written; {state}"
        return Check("compile cache", Status.WARNING, text, lasting)
    return Check("compile cache", Status.OK, f"{folder}: {state}")


def describe_temporary_cache() -> str:
    """Return in a line where machine code is kept if that is no lasting place; empty if it is."""
    found = find_cache(advance)
    if found is None or not found.temporary:
        return ""
    return f"compiled code is kept in {found.folder.parent}, as no lasting folder can be written: set NUMBA_CACHE_DIR"


def check_real_time() -> Check:
    """Check that this user may run threads ahead of all normal ones."""
    granted: list[bool] = []
    thread = threading.Thread(target=lambda: granted.append(realtime.request_fifo_scheduling()))
    thread.start()  # the right is that of a thread, and ends with it
    thread.join()
    if granted == [True]:
        return Check("real time", Status.OK, "SCHED_FIFO is granted")
    advice = "for --real-time alone: a line '@users - rtprio 20' in /etc/security/limits.conf, then log in again"
    return Check("real time", Status.WARNING, "SCHED_FIFO is refused: deadlines are missed on a busy machine", advice)


def check_autopilot(kind: str, find: Callable[[Path | None], Path]) -> Check:
    """Check where a real autopilot is built, and whether its version has been tried; none is needed."""
    try:
        build = find(None)
    except ConfigError as error:
        return Check(kind, Status.ABSENT, f"not found, and needed for --autopilot {kind} alone: {error}")
    version = read_version(kind, build)
    if doubt := doubt_version(kind, version):
        return Check(kind, Status.WARNING, f"{build}: {version}", f"{doubt}: look at the first flight's warnings")
    told = f"{version}, a version that has been tried" if version else "its version is told when it flies"
    return Check(kind, Status.OK, f"{build}: {told}")


def check_flight() -> Check:
    """Check that two processes fly over MAVLink, with the bits of the same flight without messages."""
    scenario, law = replace(load_scenario("paper-turbulence"), duration_s=_TEST_S, require=()), load_law("flagship")
    vehicle, start = load_vehicle("paper"), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        flight = fly_plan(FlightPlan(scenario, law, vehicle, 1, real_time=False), Path(folder))
        took_s = time.monotonic() - start
        if flight.outcome is not FlightOutcome.DONE:
            advice = "run it by hand: gustproof fly gust-roll --law flagship"
            return Check("test flight", Status.FAULT, flight.message, advice)
        direct = fly_direct(scenario, law, vehicle=vehicle, seed=1)
    found = f"{scenario.samples} samples over UDP in {took_s:.1f} s"
    if first_difference_s(flight.records, direct) is not None:
        advice = "report it with the versions above: results of this machine differ between routes"
        return Check("test flight", Status.FAULT, f"{found}, not the bits of the flight without messages", advice)
    return Check("test flight", Status.OK, f"{found}, the same bits as without messages")


CHECKS: tuple[tuple[str, Callable[[], list[Check]]], ...] = (
    ("versions", lambda: [check_versions()]),
    ("folder", lambda: [_check_current_folder()]),
    ("ports", lambda: list(map(check_port, _PORTS))),
    ("compile cache", lambda: [check_cache()]),
    ("real-time rights", lambda: [check_real_time()]),
    ("autopilots", lambda: [check_autopilot(kind, find) for kind, find in _FINDERS.items()]),
    ("a test flight, which compiles once after an installation", lambda: [check_flight()]),
)
"""Subject and function of each check of this installation, in order."""
