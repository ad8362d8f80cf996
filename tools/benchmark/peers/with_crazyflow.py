"""Crazyflow: a thousand drones at once under attitude control, 1 kHz, on the CPU."""

import json
import sys
import time
from importlib.metadata import version

import numpy as np
from crazyflow.sim import Sim

seconds = float(sys.argv[1])
flights = 1000
simulator = Sim(n_worlds=flights, n_drones=1, control="attitude", freq=1000, device="cpu")
simulator.reset()
command = np.zeros((flights, 1, 4), dtype=np.float32)
steps = max(int(seconds * 100), 2)


def fly(count: int) -> None:
    """Fly ten times as many steps and wait for them."""
    for _ in range(count):
        simulator.attitude_control(command)
        simulator.step(10)
    simulator.data.states.pos.block_until_ready()


fly(2)
begun = time.perf_counter()
fly(steps)
rate = flights * steps * 10 / 1000 / (time.perf_counter() - begun)
print(json.dumps({"rate": rate, "version": version("crazyflow")}))
