"""Piloting: arm, and fly in another mode.

References
----------
MAVLink, commands 176, 400.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot import Mode, Verdict
from firmware_model.services.service import DENIED, Answer, Client, Craft, Order, Service, told

_MODES = {mode.value: mode for mode in Mode}


def service(craft: Craft) -> Service:
    """Return the service that pilots the craft."""
    autopilot = craft.autopilot

    def arm(order: Order, _: Client) -> Answer:
        wanted = order.whole(1)
        if wanted not in (0, 1):
            return Answer(DENIED)
        return told(autopilot.arm() if wanted else autopilot.disarm())

    def set_mode(order: Order, _: Client) -> Answer:
        base, main, sub = order.whole(1), order.whole(2), order.whole(3) or 0
        # Bit 0 of the base mode says that main and sub mode are given (MAVSDK sends 33).
        given = base is not None and base & 1 and main is not None and main > 0
        mode = _MODES.get(main << 16 | sub << 24) if given and main is not None else None
        return told(autopilot.set_mode(mode) if mode else Verdict.NOT_FLOWN)

    return Service(
        commands={
            wire.MAV_CMD_COMPONENT_ARM_DISARM: arm,
            wire.MAV_CMD_DO_SET_MODE: set_mode,
        }
    )
