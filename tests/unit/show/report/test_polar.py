"""Polar plots: points where they belong, nothing out of nothing."""

import math
import re

from gustproof.show.report.html.polar import PolarCurve, render_polar


def test_points_stand_at_their_bearings_and_what_is_not_finite_is_left_out() -> None:
    page = render_polar(
        "wind", [PolarCurve("a<b", 1, [(0.0, 10.0), (90.0, 5.0), (180.0, math.inf), (270.0, 5.0)])], unit="m/s"
    )
    assert re.findall(r'class="dot" cx="(.*?)" cy="(.*?)"', page) == [
        ("0.0", "-150.0"),
        ("75.0", "-0.0"),
        ("-75.0", "0.0"),
    ]
    assert "<polyline" in page  # open where there is no value
    assert "a&lt;b [m/s]: 10 from 0 deg, 5 from 90 deg, 5 from 270 deg" in page
    assert re.findall(r'class="ring".*?>(.*?)<', page) == ["2", "4", "6", "8", "10"]


def test_without_a_value_there_is_no_plot() -> None:
    assert render_polar("wind", [PolarCurve("a", 0, [(0.0, math.inf)])], unit="m/s") == ""
