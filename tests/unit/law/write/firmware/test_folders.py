import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from firmware_model.config.firmware import ardupilot_full_torque, px4_full_torque
from firmware_model.config.vehicle import FullScale, MeasuredCommand, load_vehicle
from firmware_model.config.whole_file import write_folder
from firmware_model.errors import ConfigError
from firmware_model.external.interface import check_law_inside
from gustproof.law.form import load_law
from gustproof.law.write.c import AttitudeSource
from gustproof.law.write.firmware.folders import Firmware, firmware_folder

COMPILER = shutil.which("g++")
STUBS = Path(__file__).parent / "stubs"
SOURCES = {
    Firmware.PX4: ("src/modules/gustproof/Gustproof.cpp", "px4.hpp"),
    Firmware.ARDUPILOT: ("libraries/AC_CustomControl/AC_CustomControl_Gustproof.cpp", "ardupilot.hpp"),
    Firmware.CRAZYFLIE: ("src/gustproof.c", "crazyflie.h"),
}
STANDARD = ("c", "cmath", "cstring", "math.h", "stdbool.h", "string.h")
WARNINGS = ["-Wall", "-Wextra", "-Wshadow", "-Wdouble-promotion", "-Wfloat-equal", "-Wcast-align", "-Werror",
            "-Wno-unused-parameter", "-Wno-missing-field-initializers"]  # fmt: skip


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize(
    ("law", "attitude"), [("flagship", AttitudeSource.AUTOPILOT), ("pid-default", AttitudeSource.OWN)]
)
def test_every_placeholder_of_every_file_is_filled(firmware, law, attitude, make_folder):
    for name, text in make_folder(firmware, law, attitude).items():
        left = re.findall(r"\$\{?[a-z]\w*", text)
        assert not left, f"{name}: {left}"
        assert text.strip(), name


@pytest.mark.parametrize("firmware", Firmware)
def test_readme_leads_from_export_to_flight_in_five_commands(firmware, make_folder):
    text = make_folder(firmware, "flagship")["README.md"]
    block = next(part for part in re.split(r"\n(?=## )", text) if "commands\n" in part.splitlines()[0] + "\n")
    commands = [line for line in block.split("\n\nor, ")[0].splitlines() if line.startswith("    ")]
    assert commands[0].startswith("    gustproof export LAW --")
    assert 3 <= len(commands) <= 5
    assert "licence" in text
    assert "Tried with" in text


@pytest.mark.parametrize("firmware", [Firmware.PX4, Firmware.ARDUPILOT])
def test_source_holds_the_name_that_a_flight_looks_for(firmware, make_folder, tmp_path):
    source = tmp_path / "source.cpp"
    source.write_text(make_folder(firmware, "flagship")[SOURCES[firmware][0]])
    with pytest.raises(ConfigError, match="law 'flagship"):
        check_law_inside(source, "pid-fair")


@pytest.mark.slow
@pytest.mark.parametrize("law", ["flagship", "aided", "hinf-d1"])
@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")
def test_glue_compiles_against_the_names_that_it_uses(firmware, law, make_folder, tmp_path):
    compile_glue(firmware, law, make_folder, tmp_path)


@pytest.mark.parametrize("standard", ["-std=gnu++14", "-std=gnu++17"])
@pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")
def test_module_compiles_where_px4s_base_class_is_no_template(standard, make_folder, tmp_path):
    compile_glue(Firmware.PX4, "flagship", make_folder, tmp_path, standard, "-DPX4_OF_2026")


def compile_glue(firmware, law, make_folder, tmp_path, *options):
    attitude = AttitudeSource.OWN if law == "hinf-d1" else AttitudeSource.AUTOPILOT
    write_folder(tmp_path, make_folder(firmware, law, attitude))
    source, stub = SOURCES[firmware]
    path = tmp_path / source
    included = {
        name for file in path.parent.glob("*") for name in re.findall(r'#include [<"](.+)[>"]', file.read_text())
    }
    for name in included - set(STANDARD):
        if not (path.parent / name).exists():
            place = tmp_path / "stubs" / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(f'#include "{STUBS / stub}"\n')
    language = ["-std=gnu11", "-xc"] if path.suffix == ".c" else ["-std=gnu++17"]
    command = [COMPILER, *language, *WARNINGS, *options, "-fsyntax-only", f"-I{tmp_path / 'stubs'}", str(path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("vehicle", ["paper", "iris"])
def test_full_torques_are_those_of_the_autopilots_mixers(vehicle):
    rotors = load_vehicle(vehicle).rotors
    x, y = (max(abs(place[i]) for place in rotors.position_B) for i in (0, 1))
    roll, pitch, yaw = px4_full_torque(rotors)
    assert roll == pytest.approx(pitch)
    assert yaw == pytest.approx(4.0 * rotors.drag_ratio * rotors.thrust_max, rel=0.06)
    assert pitch == pytest.approx(4.0 * min(x, y) * rotors.thrust_max / 2.0**0.5)
    roll, pitch, yaw = ardupilot_full_torque(load_vehicle(vehicle))
    assert pitch == pytest.approx(2.0 * x * rotors.thrust_max)
    assert yaw == pytest.approx(2.0 * rotors.drag_ratio * rotors.thrust_max)
    assert roll == pytest.approx(sum(abs(place[1]) for place in rotors.position_B) * 0.5 * rotors.thrust_max)


def test_full_torques_of_the_paper_vehicle_are_those_that_were_flown():
    vehicle = load_vehicle("paper")
    assert px4_full_torque(vehicle.rotors) == pytest.approx((30.5, 30.5, 11.77), abs=0.02)
    assert [0.8 * each for each in ardupilot_full_torque(vehicle)] == pytest.approx([17.26, 17.26, 4.71], abs=0.01)


def test_parameters_and_module_tell_the_same_vehicle(make_folder):
    files = make_folder(Firmware.PX4, "flagship")
    values = dict(line.split()[2:] for line in files["vehicle.txt"].splitlines())
    assert values["CA_ROTOR2_PY"] == "-0.22"
    assert values["IMU_GYRO_RATEMAX"] == "250"
    # PX4's build makes no new defaults of a folder's parameters, so that a law's torques must not be among them
    assert "11.76798f};" in files["src/modules/gustproof/Gustproof.cpp"]
    assert "GP_TRQ_YAW, 0.f)" in files["src/modules/gustproof/gustproof_params.c"]


def _law(**changes):
    return replace(load_law("flagship"), **changes)


@pytest.mark.parametrize(
    ("firmware", "law", "vehicle", "words"),
    [
        (Firmware.PX4, load_law("hinf-rates"), "paper", "commands rates"),
        (Firmware.PX4, _law(dt=1.0 / 500.0), "paper", "is 500 Hz"),
        (Firmware.ARDUPILOT, _law(dt=1.0 / 40.0), "paper", "is 40 Hz"),
        (Firmware.CRAZYFLIE, _law(dt=1.0 / 400.0), "paper", "is 400 Hz"),
        (Firmware.CRAZYFLIE, _law(), "iris", "in a square"),
    ],
)
def test_what_does_not_fit_is_refused_by_one_line(firmware, law, vehicle, words):
    with pytest.raises(ConfigError, match=words) as caught:
        firmware_folder(firmware, law, load_vehicle(vehicle), AttitudeSource.OWN, "my-law", verdict="Sound.")
    assert "\n" not in str(caught.value)


def test_other_frames_than_ardupilots_x_are_refused():
    vehicle = load_vehicle("paper")
    rotors = replace(vehicle.rotors, spin=(-1, -1, 1, 1))
    with pytest.raises(ConfigError, match="quadrotor X"):
        firmware_folder(
            Firmware.ARDUPILOT,
            _law(dt=0.0025),
            replace(vehicle, rotors=rotors),
            AttitudeSource.OWN,
            "my-law",
            verdict="Sound.",
        )


@pytest.mark.parametrize("firmware", Firmware)
def test_a_guessed_torque_of_yaw_is_refused(firmware):
    command = MeasuredCommand(autopilot="px4", full_scale=FullScale.MEASURED, delay=0.0, unmeasured=("yaw",))
    guessed = replace(load_vehicle("paper"), command=command)
    with pytest.raises(ConfigError, match="its log did not excite yaw"):
        firmware_folder(firmware, _law(), guessed, AttitudeSource.OWN, "my-law", verdict="Sound.")


@pytest.mark.parametrize("firmware", Firmware)
def test_eight_rotors_are_refused_in_one_line(firmware):
    with pytest.raises(ConfigError, match=r"PX4 flies four rotors here, not 8|quadrotor X") as caught:
        firmware_folder(firmware, _law(dt=0.001), load_vehicle("octo"), AttitudeSource.OWN, "my-law", verdict="Sound.")
    assert "\n" not in str(caught.value)


def _tree(variable: str, inside: str) -> Path:
    """Return the sources that a variable names, or that its build lies in."""
    given = os.environ.get(variable)
    if not given:
        pytest.skip(f"{variable} names no tree")
    path = Path(given).resolve()
    return next(place for place in (path, *path.parents) if (place / inside).is_file())


@pytest.mark.slow
def test_module_builds_in_the_real_px4(make_folder, tmp_path):
    tree = _tree("GUSTPROOF_PX4", "src/modules/commander/Commander.cpp")
    write_folder(tmp_path / "law", make_folder(Firmware.PX4, "flagship"))
    build = tmp_path / "build"
    configure = ["cmake", "-S", str(tree), "-B", str(build), "-G", "Ninja", "-DCONFIG=px4_sitl_default",
                 f"-DEXTERNAL_MODULES_LOCATION={tmp_path / 'law'}"]  # fmt: skip
    for command in (configure, ["ninja", "-C", str(build), "modules__gustproof"]):
        done = subprocess.run(command, capture_output=True, text=True, cwd=tree)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        assert "warning: " not in done.stderr


@pytest.mark.slow
def test_edits_fit_the_real_ardupilot(make_folder, tmp_path):
    library = (
        _tree("GUSTPROOF_ARDUPILOT", "libraries/AC_CustomControl/AC_CustomControl.h") / "libraries/AC_CustomControl"
    )
    shutil.copytree(library, tmp_path / "libraries" / "AC_CustomControl")
    law = tmp_path / "law"
    write_folder(law, make_folder(Firmware.ARDUPILOT, "flagship"))
    shutil.copytree(law / "libraries", tmp_path / "libraries", dirs_exist_ok=True)
    with (law / "edits.patch").open() as edits:
        done = subprocess.run(["patch", "-p1"], stdin=edits, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "fuzz" not in done.stdout
    assert "CONT_GUSTPROOF       = 3" in (tmp_path / "libraries/AC_CustomControl/AC_CustomControl.h").read_text()
