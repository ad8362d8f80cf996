"""MuJoCo: free rigid bodies with four forces each, RK4 at 1 kHz, without turbulence or controller; all cores."""

import sys

import mujoco
import numpy as np
from mujoco import rollout
from turns import CORES, serve

flights, steps = 8 * CORES, int(float(sys.argv[1]) * 1000)
ARMS = {"a": (0.2, 0.2, 0.02), "b": (-0.2, 0.2, -0.02), "c": (-0.2, -0.2, 0.02), "d": (0.2, -0.2, -0.02)}
SITES = "".join(f'<site name="{name}" pos="{x} {y} 0"/>' for name, (x, y, _) in ARMS.items())
MOTORS = "".join(f'<motor site="{name}" gear="0 0 1 0 0 {drag}"/>' for name, (_, _, drag) in ARMS.items())
MODEL = f"""<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body><freejoint/>
<inertial pos="0 0 0" mass="1.5" diaginertia=".03 .03 .05"/>{SITES}</body></worldbody>
<actuator>{MOTORS}</actuator></mujoco>"""
model = mujoco.MjModel.from_xml_string(MODEL)
data = [mujoco.MjData(model) for _ in range(CORES)]
start = np.zeros((flights, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
start[:, 4] = 1.0
thrust = np.full((flights, steps, 4), 1.5 * 9.81 / 4)


def fly() -> float:
    """Fly all flights on a pool of threads that persists."""
    rollout.rollout(model, data, start, thrust, persistent_pool=True)
    return flights * steps * 1e-3


serve(fly)
