"""The study of real wind, on flights whose loop and wind are known."""

import csv
from pathlib import Path

import numpy as np
import pytest

from gustproof.guide.examples.real_wind import WIND, compare, load_flights, main

DT = 0.02


def write_flight(path: Path, wind: float, seed: int) -> None:
    """Write a flight of a loop of second order, which gusts move in proportion to the wind."""
    random, n = np.random.default_rng(seed), 2500
    time = np.arange(n) * DT
    asked = 0.1 * np.sin(np.outer(time, (1.0, 2.0, 0.7))) + np.cumsum(0.004 * random.standard_normal((n, 3)), axis=0)
    asked -= np.linspace(0.0, 1.0, n)[:, None] * asked[-1]
    angle, rate, gust = np.zeros(3), np.zeros(3), np.zeros(3)
    rows = []
    for k in range(n):
        gust = 0.9 * gust + (0.06 + 0.05 * wind) * random.standard_normal(3)
        rate = rate + DT * (60.0 * (asked[k] - angle) - 11.0 * rate + gust)
        angle = angle + DT * rate
        rows.append((time[k], [*quaternion(angle)], [*quaternion(asked[k])]))
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(("t", "q", "q_sp"))
        out.writerows(rows)


def quaternion(angles: np.ndarray) -> tuple[float, float, float, float]:
    """Return [x, y, z, w] of roll, pitch and yaw."""
    (a, b, c), (d, e, f) = np.cos(0.5 * angles).tolist(), np.sin(0.5 * angles).tolist()
    return d * b * c - a * e * f, a * e * c + d * b * f, a * b * f - d * e * c, a * b * c + d * e * f


@pytest.mark.slow
def test_errors_in_stronger_wind_are_predicted_and_a_file_of_another_form_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, (condition, wind) in enumerate(WIND.items()):
        for controller in ("one", "two"):
            name = f"mine_figure8_{controller}_{condition}.csv"
            write_flight(tmp_path / name, wind, 2 * number + (controller == "two"))
    (tmp_path / "mine_figure8_one_storm.csv").write_text("t,q,q_sp\n0,[0,0,0,1],[0,0,0,1]\n")
    (tmp_path / "mine_figure8_two_calm.csv").write_text("t,q\n0,1\n")
    found = compare(load_flights(tmp_path))
    assert len(found) == 2 * 3 * 3 * 5  # controllers, unseen winds, axes, bands
    misses = [each.predicted / each.measured - 1.0 for each in found]
    assert abs(float(np.median(misses))) < 0.04
    assert float(np.max(np.abs(misses))) < 0.25
    told = capsys.readouterr().err
    assert "storm.csv: left out" in told
    assert "calm.csv: left out" in told
    main(str(tmp_path))
    assert "12.1 m/s yaw   predicted" in capsys.readouterr().out
