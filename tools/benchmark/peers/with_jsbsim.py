"""JSBSim: a quadrotor in turbulence of type 4 (Dryden, MIL-F-8785C), 1 kHz, without a controller."""

import json
import sys
import time

import jsbsim

seconds = float(sys.argv[1])
jsbsim.FGJSBBase().debug_lvl = 0
simulator = jsbsim.FGFDMExec(None)
simulator.load_model("F450")
simulator.set_dt(0.001)
simulator["ic/h-sl-ft"] = 150.0
simulator["atmosphere/turb-type"] = 4
simulator["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = 49.2
simulator["atmosphere/turbulence/milspec/severity"] = 6
simulator.run_ic()
begun = time.perf_counter()
while simulator.get_sim_time() < seconds:
    simulator.run()
print(json.dumps({"rate": seconds / (time.perf_counter() - begun), "version": jsbsim.__version__}))
