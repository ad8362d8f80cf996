"""ArduPilot's built-in quadrotor, audited over MAVLink as its users fly it: level in ALT_HOLD, in the wind of SIM_*.

Its mixer stands between a pilot and the rotors, so nothing is reachable that needs the rotors one by one. It draws its
turbulence from a generator that it does not seed from outside, and tells no wind at the vehicle.
"""

import math
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import ConfigError
from firmware_model.external.ardupilot_process import find_build, place_and_links
from firmware_model.mavlink.messages import command_long_message
from firmware_model.process.child import ChildProcess
from gustproof.studies.audit.link import AutopilotLink
from gustproof.studies.audit.simulator import NotReachable, RequestedAir, Simulator, TrueMotion
from gustproof.studies.audit.turbulence import expected_turbulence

_PARAMETERS = {
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 1,
    "ARMING_CHECK": 0,
    "DISARM_DELAY": 0,
    "FS_THR_ENABLE": 0,
    "LOG_BACKEND_TYPE": 0,
    "RC_OVERRIDE_TIME": -1,  # the sticks come at the pace of the clock, its time runs faster
    "SIM_WIND_TC": 0.1,
    "SIM_WIND_T": 2,  # the same wind at all heights
    "SIM_MAG1_OFS_X": 5,
    "SIM_MAG1_OFS_Y": 5,
    "SIM_MAG1_OFS_Z": 5,  # a compass without offsets is not calibrated
    "COMPASS_OFS_X": 5,
    "COMPASS_OFS_Y": 5,
    "COMPASS_OFS_Z": 5,
}
_ALT_HOLD, _GUIDED = 2, 4
_CENTRE, _UNUSED = 1500, 65535
_PERIOD_US, _HEIGHT = 20_000, 20.0
_AT_REST, _STILL_STATES = 0.15, 100  # [m/s], for two seconds
_SHORTEST_S = 2.0  # its wind sets in over .1 s, its loops answer in about one
_TIMEOUT_S, _SPEEDUP = 180.0, 20


class ArduPilotQuad(Simulator):
    """A process of ArduCopter with its own physics, one for each step of the simulation; `close` ends it."""

    name = "ArduPilot's quadrotor"

    def __init__(self, build: Path | None) -> None:
        self._program, self._dt = find_build(build), 0.0
        self._folder: TemporaryDirectory[str] | None = None
        self._process: ChildProcess | None = None
        self._link = AutopilotLink()
        self._heard: dict[str, Any] = {}
        self._states: list[Any] = []
        self._said_s = 0.0

    def hover(self, seed: int, dt: float, air: RequestedAir, duration: float) -> list[TrueMotion]:
        """Fly level for two seconds at least."""
        if air.wind_N[2]:
            raise NotReachable("no mode of it is level and leaves the height alone")
        return self.level_flight(seed, dt, air, max(duration, _SHORTEST_S))[1]

    def level_flight(self, seed: int, dt: float, air: RequestedAir, duration: float) -> tuple[float, list[TrueMotion]]:
        """Fly level in ALT_HOLD from rest in calm air on; the wind sets in at the start."""
        if dt != self._dt:
            self.close()
            self._start(dt)
        self._set_air(RequestedAir())
        self._come_to_rest()
        self._set_air(air)
        period = _PERIOD_US * 1e-6
        self._wait(lambda: len(self._states) * period > duration, "flight")
        return period, [_motion(state) for state in self._states]

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
        if self._folder is not None:
            self._folder.cleanup()
        self._link.close()
        self._process = self._folder = None

    def _start(self, dt: float) -> None:
        self._dt, self._folder = dt, TemporaryDirectory()
        self._link = AutopilotLink()
        self._heard.clear()
        folder = Path(self._folder.name)
        rate = round(1.0 / dt)
        values = {**_PARAMETERS, "SIM_RATE_HZ": rate, "SCHED_LOOP_RATE": min(rate, 200)}
        (folder / "audit.parm").write_text("".join(f"{name} {value}\n" for name, value in values.items()))
        command = [
            str(self._program),
            "-w",
            "--model",
            "quad",
            "--speedup",
            str(_SPEEDUP),
            "--defaults",
            "audit.parm",
            *place_and_links(self._link.port),
        ]
        self._process = ChildProcess(command, folder, os.environ)
        self._wait(lambda: "HEARTBEAT" in self._heard, "heartbeat")
        for stream in (wire.MAVLINK_MSG_ID_SIM_STATE, wire.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
            self._link.send(command_long_message(wire.MAV_CMD_SET_MESSAGE_INTERVAL, 1, stream, _PERIOD_US))
        self._ask(wire.MAV_CMD_DO_SET_MODE, lambda: self._mode == _GUIDED, "GUIDED", 1, _GUIDED)
        self._ask(wire.MAV_CMD_COMPONENT_ARM_DISARM, lambda: self._armed, "arming", 1)
        self._ask(wire.MAV_CMD_NAV_TAKEOFF, lambda: self._height > 0.9 * _HEIGHT, "take-off", 0, 0, 0, 0, 0, 0, _HEIGHT)

    def _come_to_rest(self) -> None:
        self._ask(wire.MAV_CMD_DO_SET_MODE, lambda: self._mode == _GUIDED, "GUIDED", 1, _GUIDED)
        here = self._heard["LOCAL_POSITION_NED"]
        target = wire.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, wire.MAV_FRAME_LOCAL_NED, 0xDF8, here.x, here.y, -_HEIGHT, 0, 0, 0, 0, 0, 0, 0, 0
        )
        self._link.send(target)
        still = 0

        def is_at_rest() -> bool:
            nonlocal still
            for state in self._states:
                still = still + 1 if math.hypot(state.vn, state.ve, state.vd) < _AT_REST else 0
            self._states.clear()
            return still > _STILL_STATES

        self._wait(is_at_rest, "rest in calm air")
        self._ask(wire.MAV_CMD_DO_SET_MODE, lambda: self._mode == _ALT_HOLD, "ALT_HOLD", 1, _ALT_HOLD)

    def _set_air(self, air: RequestedAir) -> None:
        """Set its wind, a speed with the direction that it comes from, and its turbulence."""
        north, east, down = air.wind_N
        speed = math.hypot(north, east, down)
        values = {  # the speed comes last, as the wind acts from it on
            "SIM_WIND_DIR": math.degrees(math.atan2(-east, -north)) % 360.0 if speed else 0.0,
            "SIM_WIND_DIR_Z": math.degrees(math.asin(-down / speed)) if speed else 0.0,
            "SIM_WIND_TURB": float(expected_turbulence().intensity[0]) if air.turbulence else 0.0,
            "SIM_WIND_SPD": speed,
        }
        for name, value in values.items():
            self._states.clear()
            setting = wire.MAVLink_param_set_message(1, 1, name.encode(), value, wire.MAV_PARAM_TYPE_REAL32)
            self._wait(partial(self._is_set, name, value), name, setting)

    def _is_set(self, name: str, value: float) -> bool:
        said = self._heard.get(f"PARAM_VALUE {name}")
        return said is not None and abs(said.param_value - value) < 1e-3

    @property
    def _mode(self) -> int:
        return int(self._heard["HEARTBEAT"].custom_mode)

    @property
    def _armed(self) -> bool:
        return bool(self._heard["HEARTBEAT"].base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def _height(self) -> float:
        place = self._heard.get("LOCAL_POSITION_NED")
        return 0.0 if place is None else -float(place.z)

    def _ask(self, command: int, done: Callable[[], bool], goal: str, *parameters: float) -> None:
        self._wait(done, goal, command_long_message(command, 1, *parameters))

    def _wait(self, done: Callable[[], bool], goal: str, asking: Any = None) -> None:
        """Listen until a goal is reached, asking for it twice a second and keeping the sticks centred."""
        until_s = time.monotonic() + _TIMEOUT_S
        self._said_s = 0.0
        while not done():
            now_s = time.monotonic()
            if now_s > until_s or (self._process is not None and self._process.ending):
                words = self._heard.get("STATUSTEXT")
                said = f": {words.text}" if words is not None else ""
                raise ConfigError(f"audit ardupilot: no {goal} in {_TIMEOUT_S:g} s{said}")
            if now_s > self._said_s + 0.5:
                self._said_s = now_s
                self._link.send(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
                sticks = [_CENTRE] * 4 + [_UNUSED] * 4
                self._link.send(wire.MAVLink_rc_channels_override_message(1, 1, *sticks))
                if asking is not None:
                    self._link.send(asking)
            self._listen()

    def _listen(self) -> None:
        for message in self._link.listen():
            kind = message.get_type()
            self._heard[f"PARAM_VALUE {message.param_id}" if kind == "PARAM_VALUE" else kind] = message
            if kind == "SIM_STATE":
                self._states.append(message)


def _motion(state: Any) -> TrueMotion:
    """Return the motion of a SIM_STATE message."""
    return TrueMotion(
        (state.vn, state.ve, state.vd),
        (state.q1, state.q2, state.q3, state.q4),
        (state.xgyro, state.ygyro, state.zgyro),
    )
