"""JSBSim: a quadrotor falls through turbulence of type 4 (Dryden, MIL-F-8785C), 1 kHz, without a controller."""

import sys

import jsbsim
from turns import serve

flights, seconds = 10, float(sys.argv[1])
jsbsim.FGJSBBase().debug_lvl = 0
simulator = jsbsim.FGFDMExec(None)
simulator.load_model("F450")
simulator.set_dt(0.001)
simulator["ic/h-sl-ft"] = 10_000.0  # the ground is half a minute away
simulator["atmosphere/turb-type"] = 4
simulator["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = 49.2
simulator["atmosphere/turbulence/milspec/severity"] = 6


def fly() -> float:
    """Fly one flight after the other."""
    for _ in range(flights):
        simulator.run_ic()
        for _ in range(int(seconds * 1000)):
            simulator.run()
    return flights * seconds


serve(fly)
