import shutil

import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.export.folders import RATES, Firmware, firmware_folder
from gustproof.law.form import Law, load_law
from gustproof.law.io.c import Attitude
from gustproof.law.resample import resample

COMPILER = shutil.which("gcc") or shutil.which("cc")


@pytest.fixture
def make_folder():
    """Return what makes the files of a folder for an autopilot, of a law by its name."""

    def make(
        firmware: Firmware, law: str | Law, attitude: Attitude = Attitude.AUTOPILOT, vehicle: str = "paper"
    ) -> dict[str, str]:
        law = load_law(law) if isinstance(law, str) else law
        return firmware_folder(firmware, resample(law, RATES[firmware]), load_vehicle(vehicle), attitude, "my-law")

    return make
