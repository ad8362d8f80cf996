"""What flies stays the same to the bit: journals, figures, laws, exported C and a certificate against pinned digests.

`python tests/golden/test_digests.py` writes the list anew, where a change is meant; its commit says why. With names of
scenarios it prints their digests.
"""

import json
import os
import subprocess
import sys
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import pytest

from firmware_model.config.scenario import list_scenarios, load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.routes.controllers import fly_here
from gustproof.flight.scoring.metrics import measure
from gustproof.law.form import LAWS, list_laws, load_law
from gustproof.law.write.c import c_unit
from gustproof.prove.boundedness import certify_boundedness

PINNED = Path(__file__).with_name("digests.json")
VEHICLE = load_vehicle("paper")
OTHERS = {"rotor-failure": load_vehicle("octo")}
"""Vehicles of scenarios that the paper's can't fly."""
SCENARIOS = list_scenarios()
OTHER_PROCESSOR = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-AVX,-AVX512F",
}
"""Settings by which BLAS, NumPy and the C library take the code that they have for old processors."""


def digest(content: bytes | str) -> str:
    return sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:16]


def flights(name: str) -> dict[str, dict[str, str]]:
    """Return digests of one scenario: of the journal by law, and of each figure of all laws by its name."""
    scenario, vehicle = load_scenario(name), OTHERS.get(name, VEHICLE)
    journals: dict[str, str] = {}
    figures: dict[str, dict[str, object]] = {}
    for law in map(load_law, list_laws()):
        if law.dt != scenario.dt:
            continue
        records = fly_here(scenario, law, vehicle=vehicle, seed=1)
        journals[law.name] = digest(records.tobytes())
        for figure, value in asdict(measure(records, vehicle, scenario)).items():
            figures.setdefault(figure, {})[law.name] = value
    return {"journals": journals, "figures": {each: digest(json.dumps(values)) for each, values in figures.items()}}


def changed(found: dict[str, dict[str, str]], pinned: dict[str, dict[str, str]]) -> list[str]:
    """Return the laws and figures whose digest is not the pinned one; a figure that is new has none."""
    new = found["figures"].keys() - pinned["figures"].keys()
    return [
        name
        for part in ("journals", "figures")
        for name in sorted((found[part].keys() | pinned[part].keys()) - new)
        if found[part].get(name) != pinned[part].get(name)
    ]


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


@pytest.mark.parametrize("name", SCENARIOS)
def test_flights_of_every_law_keep_journal_and_figures(name, pinned):
    assert changed(flights(name), pinned["flights"][name]) == []


def test_a_new_figure_changes_no_digest_and_each_other_change_is_named():
    known = {"journals": {"a": "1", "b": "2"}, "figures": {"x": "3", "y": "4"}}
    assert changed({**known, "figures": {**known["figures"], "new": "5"}}, known) == []
    assert changed({"journals": {"a": "1", "c": "2"}, "figures": {"x": "6"}}, known) == ["b", "c", "x", "y"]


def test_flights_have_the_same_bits_with_the_libraries_code_for_another_processor(pinned):
    names = ["paper", "shear", "rotor-failure"]  # on the stand; wind from a bearing; eight rotors, of which one is lost
    command = [sys.executable, __file__, *names]
    told = subprocess.run(
        command, env={**os.environ, **OTHER_PROCESSOR}, check=True, capture_output=True, text=True, timeout=120.0
    )
    found = json.loads(told.stdout)
    assert {name: changed(found[name], pinned["flights"][name]) for name in names} == {name: [] for name in names}


def test_laws_and_exported_c_keep_their_bytes(pinned):
    assert laws() == pinned["laws"]


def test_certificate_keeps_its_bytes(pinned):
    assert certificate() == pinned["certificate"]


if __name__ == "__main__" and (names := sys.argv[1:]):
    sys.stdout.write(json.dumps({name: flights(name) for name in names}))
elif __name__ == "__main__":
    everything = {"flights": {name: flights(name) for name in SCENARIOS}, "laws": laws(), "certificate": certificate()}
    PINNED.write_text(json.dumps(everything, indent=1) + "\n", encoding="utf-8")
