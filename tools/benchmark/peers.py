"""What other simulators do in the same time, each in an environment of its own under .venv that is made once."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

from flights import LAW, VEHICLE, scenario
from table import Bench, in_turns

from gustproof.lanes import Case, fly_many

_ENVIRONMENTS = Path(sys.prefix) / "peers"
# What is installed, how long it is to fly [s], and what that is.
_PEERS = {
    "jsbsim": ("jsbsim==1.3.3", 20.0, "1 kHz, turbulence of type 4, without a controller"),
    "mujoco": ("mujoco==4.0.0", 200.0, "1 kHz RK4, rollout on all cores, without turbulence or controller"),
    "rotorpy": ("rotorpy==3.0.0", 1.0, "1 kHz, Dryden gusts, its own controller, one flight"),
    "crazyflow": ("crazyflow==0.4.0", 1.0, "1 kHz, attitude control, 1,000 at once on all cores, without turbulence"),
}
_INSTALL_S, _RUN_S = 150.0, 60.0


def measure(bench: Bench) -> None:
    """Measure every peer that can be installed, in turns with our flights."""
    script = scenario(bench)
    flights, share = (2, 0.1) if bench.quick else (64, 1.0)
    rates: dict[str, list[float]] = {"ours": []}

    def ours() -> None:
        fly_many(script, LAW, [Case(vehicle=VEHICLE, seed=seed) for seed in range(1, flights + 1)])

    for turn in range(1 if bench.quick else 3):
        times = in_turns({"ours": ours}, 1)["ours"]
        rates["ours"].append(flights * script.duration_s / times[0])
        for name, (wanted, seconds, _) in _PEERS.items():
            if name in bench.left_out:
                continue
            try:
                rates.setdefault(name, []).append(_rate(name, wanted, share * seconds, new=not (bench.quick or turn)))
            except (OSError, subprocess.SubprocessError, ValueError) as error:
                rates.pop(name, None)
                bench.leave_out(name, _reason(error))
    for name, values in rates.items():
        if name != "ours":
            bench.row(name, "simulated s/s", values, f"{_PEERS[name][0]}: {_PEERS[name][2]}")
    peers = [values for name, values in rates.items() if name != "ours"]
    if peers:
        best = max(peers, key=max)
        ratios = [mine / theirs for mine, theirs in zip(rates["ours"], best, strict=True)]
        bench.ratio("lanes_throughput_vs_best_peer", ratios, ">= 15", "ours on one core")


def _rate(name: str, wanted: str, seconds: float, *, new: bool) -> float:
    """Return the simulated seconds per second that a peer says, whose environment is made if it is not there."""
    folder = _ENVIRONMENTS / name
    python = folder / "bin" / "python"
    if not (folder / "installed").exists():
        if not new:
            raise FileNotFoundError("no environment")
        _install(folder, python, wanted)
    program = Path(__file__).parent / "peers" / f"with_{name}.py"
    told = _run([str(python), str(program), str(seconds)], _RUN_S, folder)
    return float(json.loads(told.splitlines()[-1])["rate"])


def _install(folder: Path, python: Path, wanted: str) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    try:
        _run([sys.executable, "-m", "venv", str(folder)], _INSTALL_S)
        _run([str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wanted], _INSTALL_S)
    except subprocess.SubprocessError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    (folder / "installed").touch()


def _run(command: list[str], timeout: float, folder: Path | None = None) -> str:
    """Return what a command prints; what it leaves behind, logs for one, stays in `folder`."""
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=timeout, cwd=folder).stdout


def _reason(error: Exception) -> str:
    if isinstance(error, subprocess.TimeoutExpired):
        return f"not done in {error.timeout:.0f} s: {' '.join(error.cmd[1:4])}"
    if isinstance(error, subprocess.CalledProcessError):
        lines = (error.stderr or "").strip().splitlines()
        return lines[-1] if lines else f"exit status {error.returncode}"
    return str(error)
