"""The live page waits for another flight while somebody looks, and takes no start that nobody waits for."""

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.law.form import load_law
from gustproof.show.live import live
from gustproof.show.live.live import LivePage


def test_a_page_that_nobody_has_open_ends_the_session(monkeypatch):
    monkeypatch.setattr(live, "_ABSENCE_S", 0.0)
    laws = load_law("hinf-d1"), load_law("pid-fair")
    with LivePage(load_scenario("gust-roll"), laws, load_vehicle("paper"), real_time=False) as page:
        page._set_law(1)
        assert page._buffer["law"] == "pid-fair"
        page._start(True)
        assert page.wait() == 1
        with pytest.raises(ValueError, match="under way"):
            page._set_law(0)
        page.end("landed")
        page._start(True)  # nobody waits for it
        assert page._buffer["phase"] == "over"
        assert page.wait_again() is None
        with pytest.raises(ValueError, match="outside 0 to 1"):
            page._set_law(2)
