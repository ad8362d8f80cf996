"""A dronekit user's program: `dronekit_client.py ADDRESS` prints its observations as one JSON object."""

import collections
import collections.abc
import importlib
import json
import sys
import time
from collections.abc import Callable

collections.MutableMapping = collections.abc.MutableMapping  # dronekit looks for it where Python 3.9 had it
dronekit = importlib.import_module("dronekit")

PATIENCE_S = 80.0


def wait_until(seen: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not seen():
        assert time.monotonic() < deadline, f"not within {PATIENCE_S} s"
        time.sleep(0.1)


def fly(address: str) -> dict:
    """Arm once the vehicle is armable, take off, land; as in dronekit's guide, but for PX4's modes."""
    vehicle = dronekit.connect(address, wait_ready=True, timeout=PATIENCE_S)
    texts: list[str] = []
    vehicle.add_message_listener("STATUSTEXT", lambda _vehicle, _name, message: texts.append(message.text))
    wait_until(lambda: vehicle.is_armable)
    on_ground = {"ekf_ok": vehicle.ekf_ok, "mode": vehicle.mode.name, "battery": vars(vehicle.battery)}
    vehicle.armed = True
    wait_until(lambda: vehicle.armed)
    vehicle.simple_takeoff(10.0)  # m above home; PX4 counts from the sea, so MIS_TAKEOFF_ALT is flown to
    wait_until(lambda: vehicle.location.global_relative_frame.alt > 0.9 * vehicle.parameters["MIS_TAKEOFF_ALT"])
    in_air = {"ekf_ok": vehicle.ekf_ok, "height_m": vehicle.location.global_relative_frame.alt}
    vehicle.mode = dronekit.VehicleMode("LAND")
    wait_until(lambda: not vehicle.armed)
    landed_m = vehicle.location.global_relative_frame.alt
    vehicle.close()
    return {"on_ground": on_ground, "in_air": in_air, "landed_m": landed_m, "texts": texts}


if __name__ == "__main__":
    print(json.dumps(fly(sys.argv[1])))
