"""What flies stays the same to the bit: journals, figures, laws, exported C and a certificate against pinned digests.

`python tests/golden/test_digests.py` writes the list anew, where a change is meant; its commit says why.
"""

import json
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import pytest

from firmware_model.config.scenario import list_scenarios, load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.certify.boundedness import certify_boundedness
from gustproof.law.form import LAWS, list_laws, load_law
from gustproof.law.io.c import c_unit
from gustproof.scoring.metrics import measure
from gustproof.simulate.direct import fly_direct
from gustproof.simulate.loopback import fly_loopback

PINNED = Path(__file__).with_name("digests.json")
VEHICLE = load_vehicle("paper")
OTHERS = {"rotor-failure": load_vehicle("octo")}
"""Vehicles of scenarios that the paper's can't fly."""
SCENARIOS = list_scenarios()


def digest(content: bytes | str) -> str:
    return sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:16]


def flights(name: str) -> dict[str, list[str]]:
    """Return the digests of journal and figures, of every law in one scenario."""
    scenario, vehicle = load_scenario(name), OTHERS.get(name, VEHICLE)
    found = {}
    for law in map(load_law, list_laws()):
        if law.dt != scenario.dt:
            continue
        fly = fly_loopback if scenario.has_link_script else fly_direct
        records = fly(scenario, law, vehicle=vehicle, seed=1)
        figures = asdict(measure(records, vehicle, scenario, 0.0))
        found[law.name] = [digest(records.tobytes()), digest(json.dumps(figures, sort_keys=True))]
    return found


def laws() -> dict[str, list[str]]:
    """Return the digests of each shipped law's file and of its C code."""
    files = {name: (LAWS / f"{name}.json").read_bytes() for name in list_laws()}
    return {name: [digest(content), digest(c_unit(load_law(name)).source)] for name, content in files.items()}


def certificate() -> str:
    """Return the digest of a certificate that exact arithmetic alone makes."""
    made = certify_boundedness("hinf-scheduled", "paper", moment=(0.65, 0.65, 0.3), horizon=60.0)
    box = [[f"{bound:.9e}" for bound in row] for row in made.evidence["box"]]  # norms are sums in doubles: by machine
    return digest(json.dumps(box))


@pytest.fixture(scope="module")
def pinned() -> dict:
    return json.loads(PINNED.read_text(encoding="utf-8"))


@pytest.mark.compiled
@pytest.mark.parametrize("name", SCENARIOS)
def test_flights_of_every_law_keep_journal_and_figures(name, pinned):
    assert flights(name) == pinned["flights"][name]


def test_laws_and_exported_c_keep_their_bytes(pinned):
    assert laws() == pinned["laws"]


def test_certificate_keeps_its_bytes(pinned):
    assert certificate() == pinned["certificate"]


if __name__ == "__main__":
    everything = {"flights": {name: flights(name) for name in SCENARIOS}, "laws": laws(), "certificate": certificate()}
    PINNED.write_text(json.dumps(everything, indent=1) + "\n", encoding="utf-8")
