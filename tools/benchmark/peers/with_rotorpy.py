"""RotorPy: a Crazyflie hovering in Dryden gusts, 1 kHz."""

import json
import sys
import time
from importlib.metadata import version
from unittest.mock import MagicMock

import numpy as np


def main(seconds: float) -> None:
    """Fly and tell the rate; torch, 2 GB that RotorPy imports for its batches alone, is left out."""
    sys.modules["torch"] = MagicMock(Tensor=type("Tensor", (), {}))
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.environments import Environment
    from rotorpy.trajectories.hover_traj import HoverTraj
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor
    from rotorpy.wind.dryden_winds import DrydenGust

    simulator = Environment(
        vehicle=Multirotor(quad_params),
        controller=SE3Control(quad_params),
        trajectory=HoverTraj(np.zeros(3)),
        wind_profile=DrydenGust(dt=0.001, sig_wind=np.full(3, 1.5)),
        sim_rate=1000,
    )
    begun = time.perf_counter()
    simulator.run(t_final=seconds, use_mocap=False, terminate=False, plot=False, animate_bool=False, verbose=False)
    print(json.dumps({"rate": seconds / (time.perf_counter() - begun), "version": version("rotorpy")}))


main(float(sys.argv[1]))
