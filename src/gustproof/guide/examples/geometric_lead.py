"""The geometric PID with lead: a filtered angular acceleration beside the published terms, see `geometric`."""

from firmware_model.config.vehicle import Vehicle
from gustproof.guide.examples.geometric import GeometricGains, GeometricPid
from gustproof.guide.examples.rotations import pick_gains

_TUNED = {
    "paper": (
        (123.07124454506985, 22.657235340308933, 121.74874229002647, 0.8217542177752114, 11.214960670208665),
        (136.85156402623173, 24.4222694301785, 135.33511862041107, 0.869452622894436, 12.478708215079218),
        (279.57236615488205, 27.097000766004257, 66.9176834624492, 0.9834961935805103, 14.867836834126923),
    ),
    "iris": (
        (769.2618115100003, 44.96920270811733, 166.21407490247776, 0.8620173904488175, 54.11531384844052),
        (350.7203280038045, 38.72394994131599, 344.4713388454909, 0.7487694720657492, 34.7441755091114),
        (510.71391261947105, 27.862939555326466, 0.0010002620097746774, 0.617876794874184, 18.660658113417014),
    ),
}
"""Gains as `GeometricGains` names them, tuned in turbulence."""


def make(vehicle: Vehicle) -> GeometricPid:
    """Return the law with lead for a vehicle."""
    return GeometricPid(vehicle, [GeometricGains(*each) for each in pick_gains(_TUNED, vehicle)])
