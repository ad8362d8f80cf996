"""Read a bag of our own flights as a log: what vehicle and controller said, without the simulation's truth."""

from pathlib import Path

import numpy as np

from firmware_model.errors import ConfigError
from gustproof.flight.recording.bag import read_bag, read_estimate_topics
from gustproof.flight.recording.folder import find_bag
from gustproof.logs.read.assemble import Draft, Rows, euler_angles
from gustproof.logs.read.flight_log import CommandUnit

_THRUST_RUNS = 0.25  # share of the largest thrust commanded


def read_own_bag(path: Path) -> Draft:
    """Return the signals of a bag: its folder, the folder of its run, or its .mcap file.

    The torque is the one commanded to the actuators, in N m. An attitude stands in the bag of a real autopilot alone.

    Raises
    ------
    ConfigError
        If there is no bag, more than one, or it can't be read.
    """
    bag = path if path.is_file() else find_bag(path)
    _, records = read_bag(bag)
    if not len(records):
        raise ConfigError(f"{path}: no samples in it")
    position = np.arange(len(records))
    time_us = records["time_us"].astype(np.float64)
    fields = {"gyro": "gyro_B", "command": "torque_command_B", "accelerometer": "specific_force_B"}
    rows = {
        name: Rows(position=position, time_us=time_us, values=records[field], is_raw=name == "gyro")
        for name, field in fields.items()
    }
    estimates = read_estimate_topics(bag)
    # Places between those of the samples, by time: both streams are of one clock that never resets.
    place = np.searchsorted(time_us, estimates["time_us"])
    for name, field in {"attitude": "q_NB", "reference": "setpoint_q_NB"}.items():
        known = np.isfinite(estimates[field]).all(axis=1)
        if known.any():
            angles = euler_angles(estimates[field][known])
            rows[name] = Rows(position=place[known], time_us=estimates["time_us"][known], values=angles)
    thrust = -records["thrust_z_command"]
    in_air = (thrust > _THRUST_RUNS * np.nanmax(thrust, initial=0.0)).astype(np.float64)
    return Draft(
        source=path.name,
        system="gustproof",
        rows=rows,
        in_air=Rows(position=position, time_us=time_us, values=in_air),
        command_unit=CommandUnit.NEWTON_METRES,
    )
