import base64
import json
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.logs.identify.air import IdentifiedAir
from gustproof.logs.identify.shown_vehicle import ShownVehicle
from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.show.report.html.log_page import render_log_page
from gustproof.show.report.vehicle_numbers import identification_document, number_rows
from gustproof.studies.logged_flight import LoggedFlight

AXES = ("roll", "pitch", "yaw")


@pytest.fixture
def found(perfect):
    return perfect(load_vehicle("iris"))


@pytest.fixture
def air():
    """Return the air of some flight."""
    omega, time = np.geomspace(0.1, 100.0, 300), np.arange(0.0, 10.0, 0.004)
    density = np.tile(1.0 / (1.0 + omega**2), (3, 1))
    return IdentifiedAir(
        wind_speed_20ft=7.0, airspeed=6.0, yaw_ratio=0.3, sigma=np.ones(3), length=np.array([67.0, 67.0, 10.0]),
        time=time, acceleration=np.zeros((len(time), 3)), omega=omega, measured=1.1 * density, fitted=density,
        noise=0.01 * density,
    )  # fmt: skip


def shown(found, air, *findings):
    return ShownVehicle(identification=found, file=None, air=air, refusal="", findings=findings)


def page_of(found, air, *findings):
    time = np.arange(0.0, float(found.time[-1]), 0.02)
    gyro = LogSignal(time=time, values=np.sin(time[:, None] + np.arange(3.0)))
    log = FlightLog(source=found.source, system="csv", gyro=gyro, airborne=((0.0, float(time[-1])),))
    return render_log_page(LoggedFlight(log=log, shown=shown(found, air, *findings), no_judgement=found.source))


def script(page, name):
    (text,) = re.findall(rf'<script type="[^"]*" id="{name}">(.*?)</script>', page, flags=re.DOTALL)
    return text


def curves(page, section, title):
    """Return label and values of the curves of each chart of a group."""
    planes = zlib.decompress(base64.b64decode(script(page, "page-numbers")))
    values = np.frombuffer(np.frombuffer(planes, dtype=np.uint8).reshape(4, -1).T.tobytes(), dtype="<f4")
    groups = json.loads(script(page, "page-data"))["sections"][section]
    (group,) = (group for group in groups if group["title"] == title)
    return [
        {curve["label"]: values[curve["y"][0] : sum(curve["y"])] for curve in chart["curves"]}
        for chart in group["charts"]
    ]


def test_the_page_shows_data_and_model(found, air):
    page = page_of(found, air)
    for k, chart in enumerate(curves(page, "response", "Angular acceleration per command")):
        assert chart["measured"] == pytest.approx(np.abs(found.response[k]), rel=1e-6)
        assert chart["model"] == pytest.approx(np.abs(found.model[k]), rel=1e-6)
    assert len(curves(page, "response", "Its coherence")) == 3
    for k, chart in enumerate(curves(page, "air", "Spectrum of what the model leaves")):
        assert chart["Dryden turbulence"] == pytest.approx(air.fitted[k], rel=1e-6)


def test_the_prediction_is_shown_for_the_whole_flight(found, air):
    page = page_of(found, air)
    assert json.loads(script(page, "page-data"))["span"] == pytest.approx([0.0, found.time[-1]], abs=0.1)
    for k, chart in enumerate(curves(page, "prediction", "Angular acceleration")):
        assert chart["measured"] == pytest.approx(found.acceleration[:, k], abs=1e-6)
    assert len(curves(page, "prediction", "Residual")) == 3


@pytest.mark.parametrize(("airspeed", "doubt"), [(6.0, ""), (213.0, ", in doubt")])
def test_an_airspeed_unlike_the_wind_is_marked_where_it_stands(found, air, airspeed, doubt):
    rows = dict(row[:2] for row in number_rows(shown(found, replace(air, airspeed=airspeed))))
    assert rows[f"its airspeed [m/s]{doubt}"] == f"{airspeed:.3g}"
    assert rows[f"its wind at 20 ft [m/s]{doubt}"] == "7"


def test_an_axis_that_is_not_identified_is_left_out(found, air):
    lost = replace(found.axes[2], gain=None, damping=None, held_out_r2=None, advice="yaw is not excited: fly a chirp")
    partial = replace(found, axes=(*found.axes[:2], lost))
    page = page_of(partial, air, lost.advice)
    assert len(curves(page, "prediction", "Residual")) == 2
    assert len(curves(page, "response", "Its phase")) == 2
    assert "fly a chirp" in page
    document = identification_document(shown(partial, None, lost.advice))
    assert document["held_out_r2"] == {"roll": 0.9, "pitch": 0.9, "yaw": None}
    assert document["gain_rad_s2_per_unit"]["yaw"] is None
    assert document["disturbance"]["dryden"] is None
    assert json.loads(json.dumps(document)) == document


def test_words_of_a_file_are_words_on_the_page(found, air):
    hostile = "</script><script>alert('1 & 2')</script>{{table}}"
    page = page_of(replace(found, source=hostile), air, hostile)
    assert "<script>alert" not in page
    assert page.count("&lt;/script&gt;") >= 2


def test_the_same_identification_gives_the_same_bytes(found, air):
    assert page_of(found, air) == page_of(found, air)
