"""`tools/bench`: the table of ratios."""

import argparse
import time
from importlib import import_module
from pathlib import Path

from table import Bench

_PARTS = ("flights", "campaigns", "lockstep", "codec", "solver", "starts", "peers")
"""Modules, each with a `measure`."""


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(
        prog="tools/bench",
        description="Ratios to limits and peers, measured in turns, for a machine with nothing else to do.",
        epilog="Peers are installed once, into .venv/peers: 1.7 GB. The table tells which are left out, and why.",
    )
    add = parser.add_argument
    add("parts", nargs="*", metavar="PART", help=f"only these: {', '.join(_PARTS)} [all]")
    add("--quick", action="store_true", help="seconds instead of minutes, for the form alone: no figure means anything")
    add("--output", type=Path, default=Path("bench.json"), help="file to be written [%(default)s]")
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
