"""Options and plan that the campaigns of `gustproof campaign` have in common."""

import sys
from contextlib import AbstractContextManager
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import typer

from firmware_model.config.validation import none_of
from firmware_model.errors import ConfigError
from gustproof.cli.options import complete

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.uncertainty import VehicleSet
    from gustproof.flight.controllers.external_autopilot import AnyController
    from gustproof.studies.campaign.plan import Campaign, DispersionKind

Choice = TypeVar("Choice", bound=Enum)
ScenarioName = Annotated[
    str,
    typer.Argument(
        help="Name of a shipped scenario, or a .toml file.", autocompletion=complete("scenario"), show_default=False
    ),
]
Workers = Annotated[
    str | None,
    typer.Option(
        help="Processes, or a cluster dask://tcp://HOST:PORT [default: one a core].",
        show_default=False,
    ),
]
SpreadKinds = Annotated[
    str | None,
    typer.Option(
        help="What varies: vehicle, gyro, gust=0.5, attitude=5 [deg] [default: gust and the file's].",
        show_default=False,
    ),
]
SamplingMethod = Annotated[str, typer.Option(help="Sampling method: uniform, normal, latin or sobol.")]

_SIZES = {"gust": (0.5, 0.01, 1.0), "attitude": (5.0, 0.01, 60.0)}
"""Default, least and largest size of a spread: of gusts around 1, of angles [deg]."""


class Draws(NamedTuple):
    """Random draws of a campaign, as on a command line."""

    runs: int
    """Flights of each law."""
    spread: str | None
    """Kinds that vary; `None` for the default."""
    sampling: str
    """Sampling method."""
    seed: int
    """Seed of all draws."""


def make_plan(
    script: "Scenario", laws: "tuple[AnyController, ...]", vehicles: "VehicleSet", draws: Draws, *, anyway: bool
) -> "Campaign":
    """Return the campaign that a command line asks for.

    Raises
    ------
    ConfigError
        If a word of its draws is wrong, or unless `anyway` a law can't fly the nominal vehicle.
    """
    from gustproof.flight.routes.flight import check
    from gustproof.law.form import Law
    from gustproof.studies.campaign.plan import Campaign, select_spreads, usual_dispersions
    from gustproof.studies.campaign.sampling import Sampling

    sizes = {kind: size for kind, (size, _, _) in _SIZES.items()}
    kinds = usual_dispersions(vehicles) if draws.spread is None else _parse_spreads(draws.spread, sizes)
    spreads = select_spreads(vehicles, script, kinds, gust=sizes["gust"], attitude_deg=sizes["attitude"])
    sampling = _parse_choice(Sampling, "--sampling", draws.sampling)
    plan = Campaign(
        scenario=script,
        laws=laws,
        vehicles=vehicles,
        spreads=spreads,
        cases=draws.runs,
        sampling=sampling,
        seed=draws.seed,
    )
    for law in () if anyway else laws:
        if isinstance(law, Law):
            check(script, law, vehicles.nominal)
    return plan


def _parse_spreads(words: str, sizes: dict[str, float]) -> "list[DispersionKind]":
    """Return the kinds of spreads that are asked for; put their sizes into `sizes`."""
    from gustproof.studies.campaign.plan import DispersionKind

    kinds = []
    for word in words.split(","):
        name, _, size = word.strip().partition("=")
        kinds.append(_parse_choice(DispersionKind, "--spread", name))
        if size and name not in sizes:
            raise ConfigError(f"--spread: the size of '{name}' stands in the vehicle file, not here")
        if size:
            sizes[name] = _parse_size(name, size)
    return kinds


def _parse_size(name: str, text: str) -> float:
    _, low, high = _SIZES[name]
    try:
        size = float(text)
    except ValueError:
        size = -1.0
    if not low <= size <= high:
        raise ConfigError(f"--spread: the size of '{name}' is '{text}', must be {low:g} .. {high:g}")
    return size


def _parse_choice(kind: type[Choice], option: str, word: str) -> Choice:
    try:
        return kind(word)
    except ValueError:
        raise ConfigError(f"{option}: {none_of(word, [choice.value for choice in kind])}") from None


def open_pool(workers: str | None) -> AbstractContextManager[Any]:
    """Return the workers that a command line asks for.

    Raises
    ------
    ConfigError
        If it asks for something else.
    """
    from gustproof.studies.campaign.executors import count_cores, dask_pool, process_pool

    if workers is None:
        return process_pool(count_cores())
    if "://" in workers:
        return dask_pool(workers)
    if not (workers.isdecimal() and 1 <= int(workers) <= 4096):
        raise ConfigError(f"--workers: is '{workers}', must be a number of processes, or dask://tcp://HOST:PORT")
    return process_pool(int(workers))


def describe_start(workers: str | None, title: str) -> str:
    """Return what is done before the first run."""
    return f"connecting to {workers}, {title}" if workers and "://" in workers else f"starting workers, {title}"


def print_status(line: str, *, quiet: bool) -> None:
    """Print a line on stderr unless `quiet`."""
    if not quiet:
        print(f"gustproof: {line}", file=sys.stderr)
