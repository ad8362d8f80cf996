"""What flies stays the same to the bit: journals, figures, laws, exported C and a certificate against pinned digests.

`python tests/golden/test_digests.py` writes the list anew, where a change is meant; its commit says why. With names of
scenarios it prints their digests.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from hashlib import sha256
from itertools import product
from pathlib import Path

import pytest

from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.scenario import list_scenarios, load_scenario
from firmware_model.config.vehicle import FullScale, MeasuredCommand, Vehicle, load_vehicle
from gustproof.flight.routes.controllers import fly_here
from gustproof.flight.scoring.metrics import measure
from gustproof.law.form import LAWS, Law, list_laws, load_law
from gustproof.law.resample import resample
from gustproof.law.write.c import AttitudeSource, c_unit
from gustproof.law.write.firmware import folders as written
from gustproof.law.write.firmware.folders import RATES, Firmware, firmware_folder
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
    """Return the digests of each shipped law's file, of its C code, and of that in all other forms."""
    files = {name: (LAWS / f"{name}.json").read_bytes() for name in list_laws()}
    return {
        name: [digest(content), digest(c_unit(load_law(name)).source), digest("".join(units(load_law(name))))]
        for name, content in files.items()
    }


def units(law: Law) -> Iterator[str]:
    """Yield header and source of a law in each form that it has."""
    for attitude, single, library in product(AttitudeSource, (False, True), (False, True)):
        if not (single and law.uses_accelerometer) and (law.is_scheduled or attitude is AttitudeSource.OWN):
            unit = c_unit(law, "law.h", attitude, single=single, notes=["a */ note"], library=library)
            yield f"{unit.header}{unit.source}{unit.operations}"


def folders() -> dict[str, str]:
    """Return a digest by firmware of what its templates are filled with, for laws and vehicles of each kind."""
    found = {}
    for firmware in Firmware:
        words: list[str] = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(written, "_fill", lambda *filled, words=words: words.append(json.dumps(filled)) or "")
            for name, vehicle, attitude, single in product(
                ("aided", "hinf-d1", "hinf-scheduled"), vehicles(firmware), AttitudeSource, (False, True)
            ):
                law = resample(load_law(name), RATES[firmware])
                if (law.is_scheduled or attitude is AttitudeSource.OWN) and not (single and law.uses_accelerometer):
                    files = firmware_folder(firmware, law, vehicle, attitude, "my", verdict="Sound.", single=single)
                    words.append(json.dumps({path: text for path, text in files.items() if "_law." not in path}))
        found[firmware.value] = digest("".join(words))
    return found


def vehicles(firmware: Firmware) -> list[Vehicle]:
    """Return a shipped vehicle, one of a file, and one that a log of the firmware measured, if it takes those."""
    command = MeasuredCommand(autopilot=firmware.value, full_scale=FullScale.MEASURED, delay=0.0, thrust_range=0.8)
    measured = [] if firmware is Firmware.CRAZYFLIE else [replace(VEHICLE, name="own", command=command)]
    return [VEHICLE, replace(VEHICLE, name="mine", mass=9.5), *measured]


def parameters() -> dict[str, str]:
    """Return type, default, unit and range of each parameter of a vehicle, as ground stations read them."""
    table = Parameters(VEHICLE, load_scenario("calm")).describe()
    return {str(each["name"]): "{type} {default} {unit}: {allowed}".format_map(each) for each in table}


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


def test_folders_for_firmware_keep_what_they_are_filled_with(pinned):
    assert folders() == pinned["folders"]


def test_parameters_keep_their_ranges(pinned):
    assert parameters() == pinned["parameters"]


def test_certificate_keeps_its_bytes(pinned):
    assert certificate() == pinned["certificate"]


if __name__ == "__main__" and (names := sys.argv[1:]):
    sys.stdout.write(json.dumps({name: flights(name) for name in names}))
elif __name__ == "__main__":
    everything = {"flights": {name: flights(name) for name in SCENARIOS}, "laws": laws(), "certificate": certificate()}
    everything |= {"folders": folders(), "parameters": parameters()}
    PINNED.write_text(json.dumps(everything, indent=1) + "\n", encoding="utf-8")
