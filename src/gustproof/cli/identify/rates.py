"""The command `gustproof identify --connect`: the autopilot's rate loops, measured in flight over MAVLink."""

import sys
from itertools import repeat
from pathlib import Path
from typing import Annotated

import typer

from firmware_model.config.validation import printable
from firmware_model.types import AXES
from gustproof.cli.links import SigningKey
from gustproof.cli.options import Force, check_output, print_next


def rates(
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the rate loops here (.toml), a new file.")],
    connect: Annotated[str, typer.Option(help="The autopilot: [udp:]HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT.")],
    bind_port: Annotated[int | None, typer.Option(help="Port to send from, as of `gustproof controller`.")] = None,
    signing_key: SigningKey = None,
    force: Force = False,
) -> None:
    """Measure the autopilot's rate loops, axis by axis, on a vehicle that hovers under its pilot.

    It adds sines of up to .3 rad/s in sum to the rates for 75 s, in the mode that takes set-points, and hands back. The
    height is held, the place is not: leave 20 m on all sides, and choose calm air.

        gustproof identify --connect udp:127.0.0.1:14580 -o my-px4.toml
        gustproof design hinfsyn R1 --inner my-px4.toml -o my-rates.json
    """
    from firmware_model.config.files import write_toml
    from gustproof.design.cascades.autotune import phasors
    from gustproof.design.inner_loops import RESONANCE, InnerLoops, fit_inner_loop
    from gustproof.flight.endpoint.excitation import DT, OMEGA, fly_excitation

    check_output(output, ".toml", "a file of rate loops")

    def report(text: str) -> None:
        print(f"gustproof: {printable(text)}", file=sys.stderr, flush=True)

    records = fly_excitation(connect, report, bind_port=bind_port, signing_key=signing_key)
    responses = [
        phasors(record.time, record.rate, OMEGA) / phasors(record.time, record.command, OMEGA) for record in records
    ]
    names = AXES
    roll, pitch, yaw = map(fit_inner_loop, repeat(OMEGA), responses, repeat(DT), names)
    loops = InnerLoops(name=output.stem, roll=roll, pitch=pitch, yaw=yaw)
    write_toml(loops, output)
    for axis, loop, fastest in zip(names, (roll, pitch, yaw), loops.fastest().tolist(), strict=True):
        model = f"{loop.omega:.1f} rad/s, damping {loop.damping:.2f}, delay {1e3 * loop.delay:.0f} ms"
        print(f"{axis:<6} {model}, misfit {loop.misfit:.2f}")
        if loop.peak >= RESONANCE:
            print(f"{axis} resonates {loop.peak:.1f} times: a law over it crosses 1 at {fastest:.2f} rad/s")
    print(f"rate loops in {output}")
    print_next("design", "hinfsyn", "R1", "--inner", output, "-o", output.with_name(f"{output.stem}-law.json"))
