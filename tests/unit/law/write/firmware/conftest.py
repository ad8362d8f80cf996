import shutil

import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.law.form import Law, load_law
from gustproof.law.resample import resample
from gustproof.law.write.c import AttitudeSource
from gustproof.law.write.firmware.folders import RATES, Firmware, firmware_folder

COMPILER = shutil.which("gcc") or shutil.which("cc")


@pytest.fixture
def make_folder():
    """Return what makes the files of a folder for an autopilot, of a law by its name."""

    def make(
        firmware: Firmware, law: str | Law, attitude: AttitudeSource = AttitudeSource.AUTOPILOT, vehicle: str = "paper"
    ) -> dict[str, str]:
        law = load_law(law) if isinstance(law, str) else law
        return firmware_folder(
            firmware, resample(law, RATES[firmware]), load_vehicle(vehicle), attitude, "my-law", verdict="Sound."
        )

    return make
