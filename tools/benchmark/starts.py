"""Start-up times of the help and of a controller."""

import socket
import subprocess
import sys
import time

from table import Bench, in_turns


def measure(bench: Bench) -> None:
    """Measure the help, the controller up to its first heartbeat, and Python itself."""
    rounds = 1 if bench.quick else 7
    actions = {
        "Python": lambda: _run("-c", "pass"),
        "gustproof --help": lambda: _run("-m", "gustproof", "--help"),
        "controller ready": _controller,
    }
    times = in_turns(actions, rounds, time.perf_counter)
    bench.row("Python alone", "s", times["Python"])
    bench.row("controller ready, kernels compiled before", "s", times["controller ready"], "target < 1.5")
    bench.ratio("help_s", times["gustproof --help"], "< .3", "seconds")


def _run(*arguments: str) -> None:
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)


def _controller() -> None:
    """Start a controller and wait for its first heartbeat."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(60.0)
        address = f"127.0.0.1:{vehicle.getsockname()[1]}"
        command = [sys.executable, "-m", "gustproof.flight.endpoint", "--law", "hinf-scheduled", "--connect", address]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            vehicle.recv(2048)
            process.kill()
