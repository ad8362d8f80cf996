"""Crazyflow: rigid bodies with rotors under attitude control at 250 Hz, in float32; 1 kHz, RK4 or Euler; all cores."""

import sys

import jax
import numpy as np
from crazyflow.sim import Sim
from crazyflow.sim.sharding import world_mesh
from turns import CORES, serve

seconds, integrator = float(sys.argv[1]), sys.argv[2]
flights = 2000 * CORES  # about the fastest of 64 to 10,000, for either integrator
jax.config.update("jax_num_cpu_devices", CORES)  # one device for each core: a single device leaves cores idle
simulator = Sim(
    n_worlds=flights,
    control="attitude",
    integrator=integrator,
    freq=1000,
    attitude_freq=250,
    force_torque_freq=250,
    mesh=world_mesh(jax.devices("cpu")),
)
command = np.zeros((flights, 1, 4), dtype=np.float32)
command[..., 3] = 0.5  # [N] a little more than the weight


def fly() -> float:
    """Continue all flights, and wait for them."""
    simulator.attitude_control(command)
    simulator.step(int(seconds * 1000))
    simulator.data.states.pos.block_until_ready()
    return flights * seconds


serve(fly)
