"""`gustproof design`: from weights to a law file."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from firmware_model.errors import ConfigError


def design(
    name: Annotated[str, typer.Argument(help="Name of a shipped design, such as D1, or a .toml file.")],
    gamma: Annotated[float | None, typer.Option(help="Level to design for.")] = None,
    backoff: Annotated[float | None, typer.Option(help="Level as a multiple (> 1) of the least possible.")] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Name of a shipped vehicle, or a .toml file [default: the design's].")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the law here (.json), its singular values beside it.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout, and nothing else.")] = False,
) -> None:
    """Solve an H-infinity design; print its level, norm, order, margins and poles, and save the law.

    gustproof design D1

    gustproof design D2 --gamma 0.25 -o my-law.json
    """
    from firmware_model.vehicle import load_vehicle
    from gustproof.report.design import design_document, save_design_figure
    from gustproof.report.document import show
    from gustproof.synthesis.derive import derive
    from gustproof.synthesis.designs import load_design

    if gamma is not None and backoff is not None:
        raise ConfigError("--gamma and --backoff both set the level: give one of them")
    if (gamma is not None and not gamma > 0.0) or (backoff is not None and not backoff > 1.0):
        raise ConfigError("--gamma must be above 0, --backoff above 1")
    if output is not None and output.suffix != ".json":
        raise ConfigError(f"{output}: a law file ends in .json")
    asked = load_design(name)
    if gamma is not None:
        asked = replace(asked, gamma=gamma)
    elif backoff is not None:
        asked = replace(asked, gamma=None, backoff=backoff)
    law, report = derive(asked, None if vehicle is None else load_vehicle(vehicle))
    if output is not None:
        law.save(output)
        save_design_figure(report, output.with_suffix(".png"))
    if as_json:
        print(json.dumps(report.document(), indent=2))
    else:
        show(design_document(report))
        if output is not None:
            print(f"law in {output}, singular values in {output.with_suffix('.png')}")
