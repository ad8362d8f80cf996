"""The command `tools/bench`: a table of ratios."""

import argparse
import time
from importlib import import_module
from pathlib import Path

from table import Bench

_PARTS = ("flights", "campaigns", "lockstep", "codec", "solver", "starts", "peers")
"""Modules, each with a function `measure`."""


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(
        prog="tools/bench",
        description="Measure ratios to limits and peers in turns, on an otherwise idle machine.",
        epilog="Peers are installed once, into .venv/peers: 1.7 GB. The table lists the peers left out, with reasons.",
    )
    add = parser.add_argument
    add("parts", nargs="*", metavar="PART", help=f"parts to measure: {', '.join(_PARTS)} [all]")
    add(
        "--quick",
        action="store_true",
        help="take seconds instead of minutes, to check the form: its figures mean nothing",
    )
    add("--output", type=Path, default=Path("bench.json"), help="file to write [%(default)s]")
    options = parser.parse_args()
    if unknown := sorted(set(options.parts) - set(_PARTS)):
        parser.error(f"no part '{unknown[0]}': one of {', '.join(_PARTS)}")
    bench, begun = Bench(quick=options.quick), time.perf_counter()
    for name in _PARTS:
        if name in (options.parts or _PARTS):
            print(f"tools/bench: {name}", flush=True)
            import_module(name).measure(bench)
            bench.save(options.output, time.perf_counter() - begun)
    bench.show(time.perf_counter() - begun)
    print(f"tools/bench: wrote {options.output}")


if __name__ == "__main__":
    main()
