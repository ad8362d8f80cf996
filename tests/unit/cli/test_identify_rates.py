"""`gustproof identify --connect` from the records of an excitation to the file of the loops."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.design.inner_loops import load_inner_loops
from gustproof.flight.endpoint import excitation
from gustproof.flight.endpoint.excitation import DT, OMEGA, AxisRecord

TIME = DT * np.arange(5000)


def answer(omega: float, damping: float) -> AxisRecord:
    """Return the record of a rate loop that answers all sines, of phase 0 in the command."""
    s = 1j * OMEGA
    response = omega**2 * np.exp(-1.5 * DT * s) / (s**2 + 2.0 * damping * omega * s + omega**2)
    waves = np.exp(np.outer(TIME, s))
    return AxisRecord(time=TIME, command=waves.real.sum(axis=1), rate=(waves @ response).real)


def test_resonant_loop_is_named_with_the_speed_of_a_law_over_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = answer(20.0, 0.6), answer(18.0, 0.6), answer(8.0, 0.06)
    monkeypatch.setattr(excitation, "fly_excitation", lambda *_, **__: records)
    path = tmp_path / "loops.toml"
    told = CliRunner().invoke(app, ["identify", "--connect", "127.0.0.1:14580", "-o", str(path)]).output
    assert "roll   20.0 rad/s, damping 0.60, delay 0 ms, misfit 0.00\npitch  18.0 rad/s" in told
    assert (
        "damping 0.06, delay 0 ms, misfit 0.00\nyaw resonates 8.3 times: a law over it crosses 1 at 0.24 rad/s" in told
    )
    assert load_inner_loops(path).yaw.damping == pytest.approx(0.06, rel=1e-3)
