"""The closure of the shipped scheduled law under the paper's moments, which several tests fly against."""

import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.certify.boundedness import certify_boundedness
from gustproof.certify.certificate import Certificate
from gustproof.law.form import load_law


@pytest.fixture(scope="session")
def closure() -> Certificate:
    """A flight of 2 s: short, so that integers of 96 places stay cheap, and the whole of the moment is covered."""
    law, vehicle = load_law("hinf-scheduled"), load_vehicle("paper")
    return certify_boundedness(law, vehicle, moment=(0.65, 0.65, 0.3), horizon=2.0)
