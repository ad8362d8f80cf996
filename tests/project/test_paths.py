"""One gyro sample in lockstep passes few files from sensor to actuator, and HIGHRES_IMU is packed in one of them."""

import ast
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink.wire import NO_SOCKET, move_frame
from firmware_model.session.exchange import fly_sample
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from gustproof.flight.endpoint.endpoint import ControllerEndpoint
from gustproof.flight.endpoint.exchange import answer_sample
from gustproof.law.form import load_law

ROOT = Path(__file__).parents[2]
SOURCES = sorted([*(ROOT / "firmware_model").rglob("*.py"), *(ROOT / "src" / "gustproof").rglob("*.py")])
VEHICLE, CONTROLLER = (0, ("vehicle", 1)), (0, ("controller", 1))
MOST_FILES, MOST_STEP_BY_STEP = 6, 12
"""In machine code, and where anything else than the next sample and its answer comes; without `process/udp.py`."""
STEPS = {"src/gustproof/law/step.py", "firmware_model/sim/step.py"}


def trace_files(run: Callable[[], None]) -> list[str]:
    """Return the files of the project whose functions `run` calls, in the order of their first call."""
    files: dict[str, None] = {}
    folders = tuple(str(ROOT / folder) for folder in ("firmware_model", "src/gustproof"))

    def note(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(folders):
            files[str(Path(name).relative_to(ROOT))] = None

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        run()
    finally:
        sys.setprofile(before)
    return list(files)


def test_a_gyro_sample_passes_few_files_from_sensor_to_actuator() -> None:
    """In a process of its own: after the tests of others, numba told no profile of the vehicle's step."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def follow_a_sample() -> None:
    """Carry one sample to the actuators, step by step and at once, and compare the files that it passes."""
    scenario = replace(load_scenario("paper-turbulence"), duration_s=0.4)
    flown: list[int] = []
    vehicle = VehicleEndpoint(load_vehicle("paper"), scenario, 1, lambda _: flown.append(1), lockstep=True)
    controller = ControllerEndpoint(load_law("hinf-d1"), VEHICLE, references=scenario.references)
    now_us, carried = 0, 0

    def turn() -> None:
        """Carry what each side sends to the other, once."""
        nonlocal carried
        carried = 0
        for datagram, address in vehicle.poll(now_us):
            if address == CONTROLLER:
                controller.receive(datagram, VEHICLE, now_us)
        for datagram, _ in controller.poll(now_us):
            vehicle.receive(datagram, CONTROLLER, now_us)
            carried += 1

    while len(flown) < 20:  # by then the heartbeats and parameters of the start are through
        turn()
        if not carried:
            now_us = max(now_us + 1, min(vehicle.deadline_us(), controller.deadline_us()))
    passed = trace_files(turn)
    assert (carried, len(flown)) == (1, 21)
    assert set(passed) >= STEPS
    assert len(passed) <= MOST_STEP_BY_STEP, f"{len(passed)} files, may be {MOST_STEP_BY_STEP}: {', '.join(passed)}"
    [(sample, _)] = vehicle.poll(now_us)
    samples, answers = vehicle.begin_exchange(), controller.begin_exchange()
    assert samples is not None
    assert answers is not None
    answers.line.put(sample)

    def turn_at_once() -> None:
        """Do the same in the kernels, as plain Python; they call the compiled steps of law and vehicle."""
        assert answer_sample(NO_SOCKET, answers, 0, 0) >= 0
        move_frame(answers.line.given, samples.line.taken)
        assert fly_sample(NO_SOCKET, samples, 0)

    passed = [*trace_files(turn_at_once), *STEPS]
    assert len(set(passed)) <= MOST_FILES, f"{len(passed)} files, may be {MOST_FILES}: {', '.join(passed)}"


def test_highres_imu_is_packed_in_one_place() -> None:
    packers = set()
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            wire = isinstance(node, ast.Attribute) and node.attr == "MAVLink_highres_imu_message"
            made = isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("EncodedMessage", "FrameTemplate"))
            if wire or (made and "MAVLINK_MSG_ID_HIGHRES_IMU" in "".join(map(ast.unparse, node.args))):
                packers.add(path)
    assert packers == {ROOT / "firmware_model" / "mavlink" / "messages.py"}


if __name__ == "__main__":
    follow_a_sample()
