"""RotorPy: one Crazyflie hovers in Dryden gusts, with one RK45 step a millisecond."""

import sys
from unittest.mock import MagicMock

import numpy as np
from turns import serve


def main(seconds: float) -> None:
    """Fly with RotorPy's own controller, without torch: 2 GB that only its batches need."""
    sys.modules["torch"] = MagicMock(Tensor=type("Tensor", (), {}))
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.environments import Environment
    from rotorpy.trajectories.hover_traj import HoverTraj
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor
    from rotorpy.wind.dryden_winds import DrydenGust

    simulator = Environment(
        # Without `first_step` the integrator calls the model twice more to choose it.
        vehicle=Multirotor(quad_params, integrator_kwargs={"method": "RK45", "first_step": 0.001}),
        controller=SE3Control(quad_params),
        trajectory=HoverTraj(np.zeros(3)),
        wind_profile=DrydenGust(dt=0.001, sig_wind=np.full(3, 1.5)),
        sim_rate=1000,
    )

    def fly() -> float:
        simulator.run(t_final=seconds, use_mocap=False, terminate=False, plot=False, animate_bool=False, verbose=False)
        return seconds

    serve(fly)


main(float(sys.argv[1]))
