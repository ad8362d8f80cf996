"""A MAVSDK user's program: `mavsdk_client.py SESSION PORT` prints its observations as one JSON object."""

import asyncio
import json
import math
import sys
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from itertools import pairwise
from statistics import mean, median

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.plugins.calibration import CalibrationAsync, CalibrationError
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.manual_control import ManualControlAsync, ManualControlError
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage
from mavsdk.asyncio.plugins.offboard import (
    AccelerationNed,
    ActuatorControl,
    ActuatorControlGroup,
    Attitude,
    AttitudeRate,
    OffboardAsync,
    OffboardError,
    PositionNedYaw,
    VelocityNedYaw,
)
from mavsdk.asyncio.plugins.param import ParamAsync, ParamError
from mavsdk.asyncio.plugins.telemetry import FlightMode, LandedState, TelemetryAsync
from mavsdk.asyncio.plugins.winch import WinchAsync, WinchError

HEIGHT_M = 10.0
LOW_M = 4.0
PHASE_S = 5.0
YAW_TORQUE = 0.001


async def until(stream: AsyncGenerator, wanted: Callable[..., bool] = lambda _: True, timeout_s: float = 40.0):
    """Return the first of the stream's values that is wanted."""
    value = None
    try:
        async with asyncio.timeout(timeout_s), aclosing(stream) as values:
            async for value in values:
                if wanted(value):
                    return value
    except TimeoutError:
        raise TimeoutError(f"{stream.__qualname__}: the last of them was {value}") from None


async def take(stream: AsyncGenerator, count: int, timeout_s: float = 40.0) -> list:
    """Return the next `count` values of a stream."""
    found: list = []
    await until(stream, lambda value: found.append(value) or len(found) == count, timeout_s)
    return found


def keep(stream: AsyncGenerator, values: list) -> asyncio.Task:
    """Append the values of a stream to `values`, until it is cancelled."""
    return asyncio.create_task(until(stream, values.append, timeout_s=600.0))


async def refusal(request, kind: type[Exception]) -> str | None:
    """Return the name of the reason for which a request is refused, `None` if it is not."""
    try:
        await request
    except kind as error:
        return error.args[0].name if hasattr(error.args[0], "name") else str(error)
    return None


async def discover(system: System) -> dict:
    telemetry, info = TelemetryAsync(system), InfoAsync(system)
    all_ok = await until(telemetry.subscribe_health_all_ok(), bool)  # home comes in a message of its own, maybe later
    health = await until(telemetry.subscribe_health(), lambda health: health.is_armable)
    version = await info.get_version()
    home = await until(telemetry.subscribe_home())
    return {
        "autopilot": (await system.autopilot_type()).name,
        "vehicle": (await system.vehicle_type()).name,
        "system": await system.get_system_id(),
        "components": await system.component_ids(),
        "version": [version.flight_sw_major, version.flight_sw_minor],
        "development": version.flight_sw_version_type.name,
        "health": vars(health),
        "all_ok": all_ok,
        "home": [home.latitude_deg, home.longitude_deg],
        "fix": (await until(telemetry.subscribe_gps_info())).fix_type.name,
        "landed": (await until(telemetry.subscribe_landed_state())).name,
        "mode": (await until(telemetry.subscribe_flight_mode())).name,
        "battery": vars(await until(telemetry.subscribe_battery())),
    }


async def change_parameters(system: System) -> dict:
    parameters = ParamAsync(system)
    listed = await parameters.get_all_params()
    await parameters.set_param_float("COM_OF_LOSS_T", 2.5)
    await parameters.set_param_int("COM_OBL_RC_ACT", 4)
    return {
        "float": {entry.name: entry.value for entry in listed.float_params},
        "int": {entry.name: entry.value for entry in listed.int_params},
        "set": [await parameters.get_param_float("COM_OF_LOSS_T"), await parameters.get_param_int("COM_OBL_RC_ACT")],
        "unknown": [
            await refusal(parameters.get_param_float("NO_SUCH_THING"), ParamError),
            await refusal(parameters.set_param_float("NO_SUCH_THING", 1.0), ParamError),
        ],
        "range": await refusal(parameters.set_param_float("COM_OF_LOSS_T", -1.0), ParamError),
    }


async def set_rates(system: System) -> dict:
    """Mean times between stamps [us], which are model time."""
    telemetry, found = TelemetryAsync(system), {}
    for rate_hz in (10.0, 50.0, 100.0):
        await telemetry.set_rate_attitude_quaternion(rate_hz)
        stamps = [q.timestamp_us for q in await take(telemetry.subscribe_attitude_quaternion(), 25)][5:]
        found[f"quaternion {rate_hz:.0f} Hz"] = mean(later - sooner for sooner, later in pairwise(stamps))
    await telemetry.set_rate_imu(250.0)
    stamps = [imu.timestamp_us for imu in await take(telemetry.subscribe_imu(), 60)][10:]
    return found | {"imu 250 Hz": mean(later - sooner for sooner, later in pairwise(stamps))}


async def take_off_and_land(system: System) -> dict:
    telemetry, action = TelemetryAsync(system), ActionAsync(system)
    await until(telemetry.subscribe_health(), lambda health: health.is_armable)
    await action.set_takeoff_altitude(HEIGHT_M)
    await action.arm()
    await until(telemetry.subscribe_armed(), bool)
    await action.takeoff()
    await until(telemetry.subscribe_in_air(), bool)
    await until(telemetry.subscribe_position(), lambda place: place.relative_altitude_m > 1.0)
    refused = await refusal(action.disarm(), ActionError)
    await until(telemetry.subscribe_position(), lambda place: place.relative_altitude_m > 0.95 * HEIGHT_M)
    rotors = await until(telemetry.subscribe_actuator_output_status())
    truth = await until(telemetry.subscribe_ground_truth())
    place = await until(telemetry.subscribe_position())
    held = await until(telemetry.subscribe_flight_mode(), lambda mode: mode is FlightMode.HOLD)
    await action.land()
    await until(telemetry.subscribe_flight_mode(), lambda mode: mode is FlightMode.LAND)
    await until(telemetry.subscribe_landed_state(), lambda state: state is LandedState.ON_GROUND)
    await until(telemetry.subscribe_armed(), lambda armed: not armed)
    landed = await until(telemetry.subscribe_position())
    return {
        "in_air": refused,
        "held": held.name,
        "rotors": [output for place, output in enumerate(rotors.actuator) if rotors.active >> place & 1],
        "truth_m": truth.absolute_altitude_m,
        "told_m": place.absolute_altitude_m,
        "landed_m": landed.relative_altitude_m,
    }


async def fly_off_board(system: System) -> dict:
    telemetry, action, offboard = TelemetryAsync(system), ActionAsync(system), OffboardAsync(system)
    await until(telemetry.subscribe_health(), lambda health: health.is_armable)
    without = [await refusal(offboard.start(), OffboardError), await ask_for_offboard(system)]
    hover = await ParamAsync(system).get_param_float("MPC_THR_HOVER")
    await action.set_takeoff_altitude(LOW_M)
    await action.arm()
    await action.takeoff()
    await until(telemetry.subscribe_position(), lambda place: place.relative_altitude_m > 0.9 * LOW_M)
    await telemetry.set_rate_imu(50.0)

    await offboard.set_attitude(Attitude(10.0, 0.0, 0.0, hover))
    await offboard.start()
    await until(telemetry.subscribe_flight_mode(), lambda mode: mode is FlightMode.OFFBOARD)
    rolled = await until(telemetry.subscribe_attitude_euler(), lambda euler: euler.roll_deg > 9.0)
    await offboard.set_attitude(Attitude(0.0, 0.0, 0.0, hover))
    await until(telemetry.subscribe_attitude_euler(), lambda euler: abs(euler.roll_deg) < 1.0)

    await offboard.set_attitude_rate(AttitudeRate(0.0, 0.0, 30.0, hover))
    await until(telemetry.subscribe_imu(), lambda imu: imu.angular_velocity_frd.down_rad_s > math.radians(27.0))
    gyro = await take(telemetry.subscribe_imu(), 25)

    await offboard.stop()
    await until(telemetry.subscribe_flight_mode(), lambda mode: mode is FlightMode.HOLD)
    await action.land()
    await until(telemetry.subscribe_armed(), lambda armed: not armed)
    return {
        "without": without,
        "rolled_deg": rolled.roll_deg,
        "yaw_rate_deg": math.degrees(median(imu.angular_velocity_frd.down_rad_s for imu in gyro)),
        "roll_rate_deg": math.degrees(median(imu.angular_velocity_frd.forward_rad_s for imu in gyro)),
    }


async def alternate_setpoints(system: System) -> dict:
    """Fly attitude, actuator control and attitude again on the stand; tell what is echoed and how the vehicle turns."""
    telemetry, action, offboard = TelemetryAsync(system), ActionAsync(system), OffboardAsync(system)
    await until(telemetry.subscribe_health(), lambda health: health.is_armable)
    hover = await ParamAsync(system).get_param_float("MPC_THR_HOVER")
    await action.arm()
    level, quarter = (Attitude(0.0, 0.0, yaw_deg, hover) for yaw_deg in (0.0, 90.0))
    turn = ActuatorControl([ActuatorControlGroup([0.0, 0.0, YAW_TORQUE, hover, 0.0, 0.0, 0.0, 0.0])])
    await offboard.set_attitude(level)
    await offboard.start()

    modes, texts, turning, phases = [], [], [], []
    echoes = {"ATTITUDE_TARGET": [], "ACTUATOR_CONTROL_TARGET": []}
    listening = [
        keep(telemetry.subscribe_flight_mode(), modes),
        keep(telemetry.subscribe_status_text(), texts),
        keep(MavlinkDirectAsync(system).subscribe_message("ATTITUDE"), turning),
        *(keep(MavlinkDirectAsync(system).subscribe_message(name), heard) for name, heard in echoes.items()),
    ]
    for setpoint in (level, turn, quarter):
        await (offboard.set_actuator_control if setpoint is turn else offboard.set_attitude)(setpoint)
        await asyncio.sleep(1.0)  # until then, values may belong to the one before
        for heard in (modes, turning, *echoes.values()):
            heard.clear()
        await asyncio.sleep(PHASE_S - 1.0)
        first, last = (json.loads(turning[index].fields_json) for index in (0, -1))
        attitude = await until(telemetry.subscribe_attitude_euler())
        phases.append(
            {
                "modes": sorted({mode.name for mode in modes}),
                "echoes": {name: len(heard) for name, heard in echoes.items()},
                "last": {name: json.loads(heard[-1].fields_json) for name, heard in echoes.items() if heard},
                "yaw_acceleration": (last["yawspeed"] - first["yawspeed"])
                / (1e-3 * (last["time_boot_ms"] - first["time_boot_ms"])),
                "yaw_deg": attitude.yaw_deg,
            }
        )
    for task in listening:
        task.cancel()
    return {"phases": phases, "texts": [text.text for text in texts]}


async def ask_for_what_is_not_there(system: System) -> dict:
    """Ask for all that this vehicle has not; note what each call said and the texts that were told meanwhile."""
    texts: list = []
    listening = keep(TelemetryAsync(system).subscribe_status_text(), texts)
    offboard, sticks = OffboardAsync(system), ManualControlAsync(system)
    parameters, action = ParamAsync(system), ActionAsync(system)
    await until(TelemetryAsync(system).subscribe_health(), lambda health: health.is_armable)
    found = {}
    for name, setpoint in (
        ("position", offboard.set_position_ned(PositionNedYaw(5.0, 0.0, -5.0, 0.0))),
        ("velocity", offboard.set_velocity_ned(VelocityNedYaw(1.0, 0.0, 0.0, 0.0))),
        ("acceleration", offboard.set_acceleration_ned(AccelerationNed(1.0, 0.0, 0.0))),
    ):
        await setpoint
        await asyncio.sleep(0.3)
        found[name] = await refusal(offboard.start(), OffboardError)
    await sticks.set_manual_control_input(0.0, 0.0, 0.5, 0.0)
    found["sticks"] = [
        await refusal(sticks.start_position_control(), ManualControlError),
        await refusal(sticks.start_altitude_control(), ManualControlError),
    ]
    found["winch"] = await refusal(WinchAsync(system).relax(1), WinchError)
    found["gimbal"] = await refusal(anext(CalibrationAsync(system).calibrate_gimbal_accelerometer()), CalibrationError)
    found["custom"] = [
        await refusal(parameters.get_param_custom("COM_OF_LOSS_T"), ParamError),
        await refusal(parameters.set_param_custom("COM_OF_LOSS_T", "2.5"), ParamError),
    ]
    found["origin"] = await refusal(action.set_gps_global_origin(47.0, 8.0, 500.0), ActionError)
    found["same origin"] = await refusal(action.set_gps_global_origin(47.397742, 8.545594, 488.0), ActionError)
    await asyncio.sleep(0.3)
    listening.cancel()
    return found | {"texts": [text.text for text in texts]}


async def ask_for_offboard(system: System) -> dict:
    """Ask for OFFBOARD without a set-point, past MAVSDK's own check; return the answer and what was said."""
    telemetry = TelemetryAsync(system)
    said = asyncio.create_task(until(telemetry.subscribe_status_text(), lambda text: "OFFBOARD" in text.text.upper()))
    number = await system.get_system_id()
    fields = {"command": 176, "param1": 1.0, "param2": 6.0} | {f"param{place}": 0.0 for place in range(3, 8)}
    order = {"target_system": number, "target_component": 1, "confirmation": 0} | fields
    await asyncio.sleep(0)
    answer = await MavlinkDirectAsync(system).send_command(
        MavlinkMessage("COMMAND_LONG", 0, 0, number, 1, json.dumps(order))
    )
    return {"result": json.loads(answer.fields_json)["result"], "said": (await said).text}


async def arm_and_disarm(system: System) -> dict:
    telemetry, action = TelemetryAsync(system), ActionAsync(system)
    await until(telemetry.subscribe_health(), lambda health: health.is_armable)
    await action.arm()
    armed = await until(telemetry.subscribe_armed(), bool)
    await action.disarm()
    return {"armed": armed, "disarmed": not await until(telemetry.subscribe_armed(), lambda armed: not armed)}


SESSIONS = {
    session.__name__: session
    for session in (
        discover,
        change_parameters,
        set_rates,
        take_off_and_land,
        fly_off_board,
        alternate_setpoints,
        ask_for_what_is_not_there,
        arm_and_disarm,
    )
}


async def main(session: str, port: str) -> None:
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(timeout_s=20.0)
        assert system is not None, "no autopilot discovered"
        print(json.dumps(await SESSIONS[session](system)))


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
