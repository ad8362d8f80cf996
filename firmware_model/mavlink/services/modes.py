"""Modes: their names for people, and the present one.

A client that is told of an AVAILABLE_MODES waits until it has them all, so that each number from 1 on is there.

References
----------
MAVLink, standard modes protocol, messages 435, 436.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Service, Stream, VehicleContext

_NAMES = {Mode.ALTCTL: "Altitude", Mode.POSCTL: "Position"}
_STANDARD = {
    Mode.POSCTL: wire.MAV_STANDARD_MODE_POSITION_HOLD,
    Mode.ALTCTL: wire.MAV_STANDARD_MODE_ALTITUDE_HOLD,
    Mode.RETURN: wire.MAV_STANDARD_MODE_SAFE_RECOVERY,
    Mode.LAND: wire.MAV_STANDARD_MODE_LAND,
    Mode.TAKEOFF: wire.MAV_STANDARD_MODE_TAKEOFF,
}


def make_service(craft: VehicleContext) -> Service:
    """Return the service that names the modes."""
    refused = {Mode.ACRO} if craft.autopilot.free else {Mode.ACRO, Mode.TAKEOFF, Mode.RETURN}
    flown = [mode for mode in Mode if mode not in refused]

    def current() -> Message:
        mode = craft.autopilot.mode
        return wire.MAVLink_current_mode_message(_standard_mode(mode), mode.value, mode.value)

    return Service(
        streams={wire.MAVLINK_MSG_ID_CURRENT_MODE: Stream(current, 2_000_000)},
        shows={wire.MAVLINK_MSG_ID_AVAILABLE_MODES: lambda index: _list_modes(flown, index)},
    )


def _list_modes(flown: list[Mode], index: int) -> list[Message]:
    """Return the mode of that number, counted from 1; all of them for 0, none if there is no such."""
    return [
        wire.MAVLink_available_modes_message(
            len(flown), number, _standard_mode(mode), mode.value, 0, _NAMES.get(mode, mode.name.capitalize()).encode()
        )
        for number, mode in enumerate(flown, 1)
        if index in (0, number)
    ]


def _standard_mode(mode: Mode) -> int:
    return int(_STANDARD.get(mode, wire.MAV_STANDARD_MODE_NON_STANDARD))
