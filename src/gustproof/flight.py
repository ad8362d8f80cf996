"""One flight from scenario to figures: flown over UDP, written as a bag, measured."""

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from firmware_model.scenario import Scenario
from firmware_model.vehicle import Vehicle
from gustproof import __version__
from gustproof.law import Law
from gustproof.metrics import Metrics, measure, peak_rate
from gustproof.recording.bag import write_bag
from gustproof.sitl import Outcome, fly


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedFlight:
    """What one flight left behind."""

    scenario: Scenario
    """Script that was flown."""
    law: Law
    """Law that flew it."""
    vehicle: Vehicle
    """Vehicle that was flown."""
    seed: int
    """Seed of gusts and noise."""
    outcome: Outcome
    """How it ended."""
    message: str
    """One line on how it ended, for people."""
    records: NDArray[np.void]
    """(n,) the journal's records."""
    bag: Path | None
    """Folder of the bag; `None` if not one sample was flown."""
    metrics: Metrics | None
    """Figures; `None` if fewer than two samples were flown."""

    @property
    def peak_rate(self) -> float:
        """[rad/s] largest magnitude of p, q, r."""
        return peak_rate(self.records)

    def named(self, scenario: str, law: str) -> bool:
        """Return whether this is a flight of `scenario` with `law`, whatever the seed."""
        return (self.scenario.name, self.law.name) == (scenario, law)

    def document(self) -> dict[str, Any]:
        """Return the flight as JSON has it; the figures stand at the top level under their names."""
        return {
            "scenario": self.scenario.name,
            "law": self.law.name,
            "vehicle": self.vehicle.name,
            "seed": self.seed,
            "outcome": self.outcome.name.lower(),
            "message": self.message,
            "bag": None if self.bag is None else str(self.bag),
            **({} if self.metrics is None else asdict(self.metrics)),
        }


def fly_and_record(
    scenario: Scenario,
    law: Law,
    *,
    vehicle: Vehicle,
    seed: int,
    out: Path,
    real_time: bool = False,
    progress: Callable[[float], None] | None = None,
) -> RecordedFlight:
    """Fly a scenario over UDP and leave its bag in the folder `out`, named for scenario, law and seed.

    The journal is removed once its bag is whole, or if there is nothing in it.

    Raises
    ------
    ConfigError
        If the bag exists already, or the flight can't be started as asked.
    """
    flown = fly(scenario, law, vehicle=vehicle, seed=seed, out=out, real_time=real_time, progress=progress)
    bag = None
    if len(flown.records):
        bag = out / f"{scenario.name}-{law.name}-seed{seed}"
        write_bag(bag, flown.records, _about(scenario, law, vehicle, seed, flown.outcome))
    flown.journal.unlink(missing_ok=True)
    figures = len(flown.records) >= 2
    return RecordedFlight(
        scenario=scenario,
        law=law,
        vehicle=vehicle,
        seed=seed,
        outcome=flown.outcome,
        message=flown.message,
        records=flown.records,
        bag=bag,
        metrics=measure(flown.records, vehicle, scenario, flown.realtime_factor) if figures else None,
    )


def _about(scenario: Scenario, law: Law, vehicle: Vehicle, seed: int, outcome: Outcome) -> dict[str, Any]:
    """Return what names the flight; nothing that differs when the same flight is flown again."""
    return {
        "scenario": to_jsonable_python(scenario),
        "vehicle": to_jsonable_python(vehicle),
        "law": {"name": law.name, "order": law.order, "provenance": to_jsonable_python(law.provenance)},
        "seed": seed,
        "outcome": outcome.name.lower(),
        "versions": {"gustproof": __version__, "python": platform.python_version(), "numpy": np.__version__},
    }
