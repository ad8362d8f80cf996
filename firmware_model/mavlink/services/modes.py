"""Flight modes: their displayed names, and the current mode.

After one AVAILABLE_MODES a client waits for all of them, so every index from 1 on exists.

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


def make_service(context: VehicleContext) -> Service:
    """Return the service of the flight modes."""
    refused = {Mode.ACRO} if context.autopilot.free else {Mode.ACRO, Mode.TAKEOFF, Mode.RETURN}
    flown = [mode for mode in Mode if mode not in refused]

    def current() -> Message:
        mode = context.autopilot.mode
        return wire.MAVLink_current_mode_message(_standard_mode(mode), mode.value, mode.value)

    return Service(
        streams={wire.MAVLINK_MSG_ID_CURRENT_MODE: Stream(current, 2_000_000)},
        on_request={wire.MAVLINK_MSG_ID_AVAILABLE_MODES: lambda index: _list_modes(flown, index)},
    )


def _list_modes(flown: list[Mode], index: int) -> list[Message]:
    """Return the mode of an index, counted from 1; all modes for 0, none for any other index."""
    return [
        wire.MAVLink_available_modes_message(
            len(flown), number, _standard_mode(mode), mode.value, 0, _NAMES.get(mode, mode.name.capitalize()).encode()
        )
        for number, mode in enumerate(flown, 1)
        if index in (0, number)
    ]


def _standard_mode(mode: Mode) -> int:
    return int(_STANDARD.get(mode, wire.MAV_STANDARD_MODE_NON_STANDARD))
