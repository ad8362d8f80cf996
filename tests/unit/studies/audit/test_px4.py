"""The audit of PX4's own simulator, SIH, against stand-ins; GUSTPROOF_PX4 names a real one."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from firmware_model.config.vehicle import GRAVITY
from firmware_model.errors import ConfigError
from gustproof.studies.audit import px4, px4_flight
from gustproof.studies.audit.adapters import load_simulator
from gustproof.studies.audit.checks import AuditVerdict, audit
from gustproof.studies.audit.px4_flight import AuditPhase, Record, record_flight
from gustproof.studies.audit.simulator import STILL, Array, FlightStart, NotReachable

REAL = os.environ.get("GUSTPROOF_PX4", "")
STATED = {"SIH_MASS": 1.0, "SIH_IXX": 0.025, "SIH_IYY": 0.025, "SIH_IZZ": 0.03, "SIH_T_MAX": 5.0, "SIH_Q_MAX": 0.1}
STATED |= {"SIH_L_ROLL": 0.2, "SIH_L_PITCH": 0.2, "SIH_T_TAU": 0.05}
CORNERS = ((1, 1, 0.05), (-1, -1, 0.05), (1, -1, -0.05), (-1, 1, -0.05))
WINDS = {"SIH_WIND_N": 0.0, "SIH_WIND_E": 0.0}
STATED |= {f"CA_ROTOR{i}_{name}": c[k] for i, c in enumerate(CORNERS) for k, name in enumerate(("PX", "PY", "KM"))}
NO_WIND = {"sign of wind", "turbulence", "step of turbulence", "seeds"}


@pytest.fixture
def build(tmp_path: Path) -> Path:
    (tmp_path / "build" / "etc" / "init.d-posix").mkdir(parents=True)
    (tmp_path / "build" / "etc" / "init.d-posix" / "rcS").write_text(". px4-rc.params\n")
    (tmp_path / "build" / "bin").mkdir()
    (tmp_path / "build" / "bin" / "px4").symlink_to(Path(__file__).with_name("sih"))
    return tmp_path / "build"


def verdicts(build: Path) -> dict[str, set[AuditVerdict]]:
    rows = audit(load_simulator("px4", build))
    return {test: {row.verdict for row in rows if row.test == test} for test in {row.test for row in rows}}


class Quad:
    """Steps of Euler's, as SIH takes them, with all or none of four faults; its flights begin with a settled hover."""

    def __init__(self, *, is_faulty: bool, wind: float = 0.0) -> None:
        signs = np.array(CORNERS)
        self.wind, self.stated = wind, STATED | (WINDS if wind else {})
        self.is_faulty, self.flights, self.height = is_faulty, 0, 2.0
        self.speeds: list[float] = []
        arm, yaw = (1.6, -1.0) if is_faulty else (1.0, 1.0)
        self.torque = np.array([-0.2 * arm * signs[:, 1], 0.2 * signs[:, 0], 0.02 * yaw * np.sign(signs[:, 2])])
        self.inertia = np.array((0.025, 0.025, 0.03))

    def record(self, _: Path, parameters: Mapping[str, str], phases: Sequence[AuditPhase], speed: float) -> Record:
        """Stand in for `record_flight`; in every seventh flight a command comes late."""
        self.flights += 1
        self.speeds.append(speed)
        tau = float(parameters.get("SIH_T_TAU", 0.1 if self.is_faulty else 0.05))
        wind = self.wind * np.array([float(parameters.get(name, 0.0)) for name in (*WINDS, "")])
        dt, hover = 0.004, phases[1].rotors if phases[1:] else np.full(4, 0.49)
        commands = [hover, hover, *[hover * 0.9] * (self.flights % 7 == 3)]
        for rotors, duration, is_pulse in phases[2:] or phases[-1:]:
            sent = len(commands)
            commands += [rotors.round(3)] * round(duration / dt) + [np.zeros(4)] * is_pulse
        u, v, q, w = hover, np.zeros(3), Rotation.identity(), np.zeros(3)
        rows: list[tuple[Array, Array, Array]] = []
        for command in commands:
            rows.append((v, np.roll(q.as_quat(), 1), w))
            u = u + dt / tau * (command - u)
            thrust = 5.0 * u
            spin = np.zeros(3) if self.is_faulty else np.cross(w, self.inertia * w)
            turn = (self.torque @ thrust - 0.025 * w - spin) / self.inertia
            pull = np.array((0.0, 0.0, 9.808)) - q.apply((0.0, 0.0, thrust.sum())) - 0.1 * (v + wind)
            v, q, w = v + dt * pull, q * Rotation.from_rotvec(dt * w), w + dt * turn
        stamps = 4000 * np.arange(len(rows))
        velocity, attitude, rates = (np.array(column) for column in zip(*rows, strict=True))
        height = np.full(len(rows), self.height)
        return Record(stamps, np.array(commands), height, velocity, attitude, rates, self.stated, int(stamps[sent]))


@pytest.fixture
def _in_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4, "_STEP_US", 4000)
    monkeypatch.setattr(px4, "_SPARE_S", 0.02)


@pytest.mark.usefixtures("_in_few_steps")
@pytest.mark.parametrize("is_faulty", [False, True])
def test_planted_faults_fail_their_tests_alone(monkeypatch: pytest.MonkeyPatch, build: Path, is_faulty: bool) -> None:
    monkeypatch.setattr(px4, "record_flight", Quad(is_faulty=is_faulty).record)
    found = verdicts(build)
    failed = {"rotor geometry", "sign of axes", "gyroscopic term", "actuator lag"} if is_faulty else set()
    assert {test for test, each in found.items() if AuditVerdict.FAILED in each} == failed
    assert {test for test, each in found.items() if AuditVerdict.NOT_REACHABLE in each} == NO_WIND


@pytest.mark.usefixtures("_in_few_steps")
@pytest.mark.parametrize(("wind", "verdict"), [(1.0, AuditVerdict.PASSED), (-1.0, AuditVerdict.FAILED)])
def test_steady_wind_of_newer_versions_is_tested(
    monkeypatch: pytest.MonkeyPatch, build: Path, wind: float, verdict: AuditVerdict
) -> None:
    monkeypatch.setattr(px4, "record_flight", Quad(is_faulty=False, wind=wind).record)
    found = verdicts(build)
    assert found.pop("sign of wind") == {verdict, AuditVerdict.NOT_REACHABLE}  # it has none downward
    assert {test for test, each in found.items() if AuditVerdict.NOT_REACHABLE in each} == NO_WIND - {"sign of wind"}


@pytest.mark.usefixtures("_in_few_steps")
def test_start_that_is_never_reached_is_told(monkeypatch: pytest.MonkeyPatch, build: Path) -> None:
    quad = Quad(is_faulty=False)
    monkeypatch.setattr(quad, "torque", np.zeros((3, 4)))
    monkeypatch.setattr(px4, "record_flight", quad.record)
    simulator, hover = load_simulator("px4", build), np.full(4, 0.25 * GRAVITY / 5.0)
    with pytest.raises(NotReachable, match="none of 8 flights began as asked"):
        simulator.fly(1, 0.004, STILL, FlightStart(hover, (1.0, 0.0, 0.0)), hover, 0.02)
    with pytest.raises(NotReachable, match="unequal ones turn it"):
        simulator.fly(1, 0.004, STILL, FlightStart(np.array((0.4, 0.5, 0.5, 0.5))), hover, 0.02)


@pytest.mark.usefixtures("_in_few_steps")
def test_flight_that_begins_on_the_ground_is_flown_again_more_slowly(
    monkeypatch: pytest.MonkeyPatch, build: Path
) -> None:
    quad = Quad(is_faulty=False)
    monkeypatch.setattr(quad, "height", 0.0)
    monkeypatch.setattr(px4, "record_flight", quad.record)
    simulator, still = load_simulator("px4", build), np.zeros(4)
    assert simulator.airframe.mass == 1.0
    with pytest.raises(NotReachable, match="none of 8 flights began as asked"):
        simulator.fly(1, 0.004, STILL, FlightStart(still), still, 0.02)
    assert quad.speeds[1:] == [10.0, 10.0, 5.0, 5.0, 2.5, 2.5, 1.25, 1.25]


@pytest.mark.parametrize("script", [". px4-rc.params", 'env; "PX4_PARAM_"*'])
def test_process_flies_phases_and_is_read_from_its_log(build: Path, script: str) -> None:
    (build / "etc" / "init.d-posix" / "rcS").write_text(script)
    climb, pulse, last = np.full(4, 0.6), np.array((0.4, 0.5, 0.4, 0.4)), np.array((0.1, 0.2, 0.3, 0.4))
    phases = [AuditPhase(climb, 1.2), AuditPhase(pulse, 0.1, is_pulse=True), AuditPhase(last, 0.2)]
    record = record_flight(build, {"SIH_T_TAU": "0.25"}, phases, 10.0)
    assert record.parameters["SIH_T_TAU"] == 0.25
    assert np.all(np.diff(record.time_us) == 4000)
    begins = np.flatnonzero(np.any(np.diff(record.rotors, axis=0), axis=1)) + 1
    seen = [np.zeros(4), *record.rotors[begins]]
    assert np.allclose(seen, [np.zeros(4), climb, pulse, np.zeros(4), last])
    assert np.diff(record.time_us[begins])[1] == 100_000
    assert record.time_us[begins[-2]] <= record.sent_us <= record.time_us[begins[-1]]
    assert np.allclose(record.velocity_N[:, 2], -record.rotors[:, 0])
    assert np.all(record.height == 2.0)
    assert record.omega_B[-1, 0] > 0.0


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("exit", "PX4 ended with status 1; it said last: ERROR .init. simulator_sih: not found"),
        ("log", "PX4 has not logged"),
        ("deaf", "PX4 has SIH_T_TAU 0.05 where 0.25 was set"),
    ],
)
def test_process_that_fails_is_one_line(monkeypatch: pytest.MonkeyPatch, build: Path, fault: str, said: str) -> None:
    monkeypatch.setenv("PEER_FAULT", fault)
    with pytest.raises(ConfigError, match=f"audit px4: {said}"):
        record_flight(build, {"SIH_T_TAU": "0.25"}, [AuditPhase(np.zeros(4), 0.1)], 10.0)


def test_process_that_does_not_obey_is_given_up(monkeypatch: pytest.MonkeyPatch, build: Path) -> None:
    monkeypatch.setattr(px4_flight, "_TIMEOUT_S", 1.0)
    monkeypatch.setattr(px4_flight, "_STREAM", "HIL_CONTROLS")
    with pytest.raises(ConfigError, match=r"audit px4: PX4 (has no start in 1 s|ended with status 1)"):
        record_flight(build, {}, [], 10.0)


@pytest.mark.skipif(not REAL, reason="GUSTPROOF_PX4 names no build of PX4")
def test_real_one_passes_all_but_what_needs_wind() -> None:
    found = verdicts(Path(REAL))
    assert found.pop("sign of wind") in (
        {AuditVerdict.NOT_REACHABLE},
        {AuditVerdict.NOT_REACHABLE, AuditVerdict.PASSED},
    )
    assert all(
        each == {AuditVerdict.NOT_REACHABLE if test in NO_WIND else AuditVerdict.PASSED} for test, each in found.items()
    )
