from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording.journal import RECORD
from gustproof.law.form import load_law
from gustproof.recording.bag import write_bag
from gustproof.simulate.flight import FlightPlan


@pytest.fixture
def drawn(monkeypatch):
    """Catch figures when they are saved, so that what they show can be asked."""
    caught: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: caught.append(self))
    return caught


@pytest.fixture
def recorded(tmp_path):
    """Record flights that nobody flew: what stands in the journal is given by field."""

    def make(folder, *, scenario="coning", law="hinf-d1", seed=1, n=500, require=(), **fields):
        script = replace(load_scenario(scenario), duration_s=n / 250, require=require)
        plan = FlightPlan(script, load_law(law), load_vehicle("paper"), seed, False)
        records = np.zeros(n, dtype=RECORD)
        records["time_us"] = 4000.0 * np.arange(n)
        records["q_NB"][:, 0] = 1.0
        records["omega_command_B"] = np.nan
        for name, values in fields.items():
            records[name] = values
        write_bag(tmp_path / folder / plan.name, records, {**plan.note(), "outcome": "done"})
        return tmp_path / folder

    return make
