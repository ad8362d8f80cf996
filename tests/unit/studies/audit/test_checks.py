"""The audit: our own simulator and a sound peer pass, and each planted defect fails its tests and no others."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.cli.app import app
from gustproof.studies.audit.adapters import load_simulator
from gustproof.studies.audit.checks import AuditVerdict, Row, audit
from gustproof.studies.audit.own import OwnSimulator
from gustproof.studies.audit.simulator import (
    Airframe,
    Array,
    FlightStart,
    NotReachable,
    RequestedAir,
    Simulator,
    TrueMotion,
    to_vector,
)
from gustproof.studies.audit.turbulence import expected_turbulence

FRAME = Airframe(
    mass=2.0,
    inertia_B=(0.02, 0.03, 0.04),
    position_B=((0.2, 0.25, 0.0), (-0.2, -0.25, 0.0), (0.2, -0.25, 0.0), (-0.2, 0.25, 0.0)),
    spin=(1, 1, -1, -1),
    drag_ratio=0.02,
    thrust_max=12.0,
    thrust_square=0.4,
    actuator_lag=0.04,
)
SUBSTEPS = 2


@dataclass
class Peer(Simulator):
    """A simulator of another make: Euler steps in numpy, gusts of filtered noise; each field is a defect to plant."""

    actual: Airframe = FRAME
    gravity: float = 9.80665
    wind_sign: float = 1.0
    gyroscopic: float = 1.0
    yaw_sign: float = 1.0
    turn_sign: float = 1.0
    noise_by_step: bool = False
    intensity: float = 1.0
    slower: float = 1.0
    fixed_seed: bool = False
    unseeded: bool = False
    draws: Iterator[int] = field(default_factory=count)
    """Numbers for a peer without seeds: other ones in each flight, the same in each test."""
    name = "a peer"

    @property
    def airframe(self) -> Airframe:
        return FRAME

    def reset(self, seed: int, dt: float, air: RequestedAir, start: FlightStart) -> TrueMotion:
        self.dt, self.attitude = dt, Rotation.identity()
        self.v, self.omega, self.thrusts = np.zeros(3), np.array(start.omega_B), self.actual.thrusts(start.rotors)
        self.winds, self.wrench = iter(self.sample_air(seed, dt, air, 500)), self.actual.wrench
        return self.motion()

    def step(self, rotors: Array) -> TrueMotion:
        frame, h, wind = self.actual, self.dt / SUBSTEPS, self.wind_sign * next(self.winds)
        inertia, settled = np.array(frame.inertia_B), frame.thrusts(rotors)
        for _ in range(SUBSTEPS):
            self.thrusts = self.thrusts + h / frame.actuator_lag * (settled - self.thrusts)
            L, M, N, thrust = self.wrench @ self.thrusts
            force = self.attitude.apply((0.0, 0.0, -thrust)) + 0.5 * (wind - self.v)
            p, q, r = self.omega
            cross = (
                (inertia[2] - inertia[1]) * q * r,
                (inertia[0] - inertia[2]) * r * p,
                (inertia[1] - inertia[0]) * p * q,
            )
            moment = (L, M, self.yaw_sign * N) - self.gyroscopic * np.array(cross)
            self.v = self.v + h * (force / frame.mass + (0.0, 0.0, self.gravity))
            self.attitude = self.attitude * Rotation.from_rotvec(self.turn_sign * h * self.omega)
            self.omega = self.omega + h * (moment / inertia - 0.3 * self.omega)
        return self.motion()

    def sample_air(self, seed: int, dt: float, air: RequestedAir, samples: int) -> Array:
        if air.turbulence is None:
            return np.tile(air.wind_N, (samples, 1))
        number = next(self.draws) if self.unseeded else 0 if self.fixed_seed else seed
        model, generator = expected_turbulence(), np.random.default_rng(number)
        scale = 1.0 / np.sqrt(0.02 if self.noise_by_step else dt)
        gusts = []
        for axis in range(3):
            sigma, tau = self.intensity * model.intensity[axis], self.slower / model.break_rate[axis]
            gain = sigma * np.sqrt((2.0 if axis == 0 else 1.0) * tau)
            top = [gain] if axis == 0 else [gain * np.sqrt(3.0) * tau, gain]
            bottom = [tau, 1.0] if axis == 0 else [tau * tau, 2.0 * tau, 1.0]
            noise = scale * generator.standard_normal(samples)
            gusts.append(lfilter(*bilinear(top, bottom, 1.0 / dt), noise))
        return np.add(air.wind_N, np.array(gusts).T)

    def motion(self) -> TrueMotion:
        x, y, z, w = self.attitude.as_quat()
        return TrueMotion(to_vector(self.v), (float(w), float(x), float(y), float(z)), to_vector(self.omega))


def with_arms(factor: float) -> Airframe:
    """Return the airframe with arms longer than stated."""
    return replace(FRAME, position_B=tuple((factor * x, factor * y, z) for x, y, z in FRAME.position_B))


def make_simulator() -> Simulator:
    """Return a peer with a wind of the wrong sign."""
    return Peer(wind_sign=-1.0)


def failures(rows: list[Row]) -> set[str]:
    return {row.test for row in rows if row.verdict is AuditVerdict.FAILED}


@pytest.mark.parametrize("vehicle", ["iris", "paper"])
def test_own_simulator_passes_every_test(vehicle: str) -> None:
    rows = audit(OwnSimulator(load_vehicle(vehicle)))
    assert {row.verdict for row in rows} == {AuditVerdict.PASSED}
    assert len({row.test for row in rows}) == 11
    assert all(row.measured and row.expected and row.found and row.source for row in rows)


def test_sound_peer_passes_every_test() -> None:
    assert [row for row in audit(Peer()) if row.verdict is not AuditVerdict.PASSED] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("peer", "found"),
    [
        (Peer(wind_sign=-1.0), {"sign of wind"}),
        (Peer(actual=with_arms(1.6)), {"rotor geometry"}),
        (Peer(actual=with_arms(1.0 / 1.6)), {"rotor geometry"}),
        (Peer(noise_by_step=True), {"step of turbulence"}),
        (Peer(gyroscopic=0.0), {"gyroscopic term"}),
        (Peer(gravity=9.7), {"gravity"}),
        (Peer(actual=replace(FRAME, actuator_lag=0.08)), {"actuator lag"}),
        (Peer(actual=replace(FRAME, thrust_square=0.0)), {"thrust curve"}),
        (Peer(actual=replace(FRAME, drag_ratio=0.032)), {"rotor geometry"}),
        (Peer(yaw_sign=-1.0), {"rotor geometry", "sign of axes"}),
        (Peer(turn_sign=-1.0), {"kinematics", "sign of axes"}),
        (Peer(intensity=0.5), {"turbulence"}),
        (Peer(slower=15.0), {"turbulence"}),
        (Peer(fixed_seed=True), {"seeds"}),
        (Peer(unseeded=True), {"seeds"}),
    ],
)
def test_planted_defect_fails_its_own_tests_only(peer: Peer, found: set[str]) -> None:
    assert failures(audit(peer)) == found


def test_geometry_row_shows_the_factor() -> None:
    rows = {row.measured: row for row in audit(Peer(actual=with_arms(1.6)))}
    row = rows["roll torque of each rotor per thrust: y [m]"]
    assert row.expected == "0.25, -0.25, -0.25, 0.25"
    assert row.found == pytest.approx((0.4, -0.4, -0.4, 0.4), rel=1e-2)


class WindOnly(Simulator):
    """A simulator that tells of its wind alone."""

    name = "wind only"

    def sample_air(self, seed: int, dt: float, air: RequestedAir, samples: int) -> Array:
        return Peer().sample_air(seed, dt, air, samples)


class Unsteerable(Peer):
    """A simulator whose rotors cannot be commanded."""

    def reset(self, seed: int, dt: float, air: RequestedAir, start: FlightStart) -> TrueMotion:
        raise NotReachable("no rotors")

    @property
    def airframe(self) -> Airframe:
        return FRAME


def test_unreachable_quantities_are_not_passed() -> None:
    verdicts = {row.test: row.verdict for row in audit(WindOnly())}
    assert verdicts["turbulence"] is verdicts["step of turbulence"] is AuditVerdict.PASSED
    assert verdicts["sign of wind"] is verdicts["rotor geometry"] is AuditVerdict.NOT_REACHABLE
    rows = audit(Unsteerable())
    assert [row.expected for row in rows if row.test == "sign of wind"] == ["no rotors"]


def test_command_prints_the_failed_tests_and_exits_with_one() -> None:
    result = CliRunner().invoke(app, ["audit", __file__, "--json"])
    rows = json.loads(result.stdout)["rows"]
    assert result.exit_code == 1
    assert {row["test"] for row in rows if row["verdict"] == "FAILED"} == {"sign of wind"}
    assert "FAILED" in CliRunner().invoke(app, ["audit", __file__]).stdout


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 / 0", "ZeroDivisionError"),
        ("", "has no attribute 'make_simulator'"),
        ("def make_simulator(): return 3", "must return a gustproof.studies.audit.simulator.Simulator"),
    ],
)
def test_bad_adapter_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "adapter.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        load_simulator(str(path))


@pytest.mark.parametrize("name", ["gazebo", "none.py"])
def test_unknown_simulator_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"must be own|no such file"):
        load_simulator(name)


def test_rotorpy_shows_its_defects() -> None:
    pytest.importorskip("rotorpy", reason="RotorPy is not installed")
    rows = audit(load_simulator("rotorpy"))
    assert failures(rows) <= {"turbulence", "step of turbulence"}
    assert {row.test for row in rows if row.verdict is AuditVerdict.PASSED} >= {
        "gravity",
        "rotor geometry",
        "sign of wind",
    }
