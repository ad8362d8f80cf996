"""Kills processes of a flight after an exact number of samples: KILL="controller fly vehicle 1234" in the environment.

Python runs this file at its start if its folder is on PYTHONPATH; it acts in the vehicle's process, or in its copy.
"""

import os
import signal
import sys

if "KILL" in os.environ and {"firmware_model", "gustproof"} & {*sys.orig_argv}:
    import psutil

    from firmware_model.recording.journal import JournalWriter
    from firmware_model.session import vehicle_endpoint

    *_victims, _moment = os.environ["KILL"].split()
    _append, _fly_samples, _flown = JournalWriter.append, vehicle_endpoint.fly_samples, 0

    def _kill(victim: str) -> None:
        fly = psutil.Process(os.getppid())
        if victim == "controller":
            (controller,) = [
                child for child in fly.children() if "endpoint" in " ".join([child.name(), *child.cmdline()])
            ]
            controller.kill()
        else:
            os.kill({"fly": fly.pid, "vehicle": os.getpid()}[victim], signal.SIGKILL)

    def _kill_at(flown: int) -> None:
        global _flown
        before, _flown = _flown, flown
        if before < int(_moment) <= flown:
            for victim in _victims:
                _kill(victim)

    def _append_and_kill(self, records) -> None:
        _append(self, records)
        _kill_at(max(_flown, self._flushed + self._used))

    def _fly_and_kill(socket, samples) -> None:
        """Kill in the midst of machine code: what it has flown is in memory alone."""
        left = int(_moment) - samples.sample
        _fly_samples(socket, samples._replace(turns=min(samples.turns, left)) if left > 0 else samples)
        _kill_at(max(_flown, samples.sample + samples.line.turns))

    JournalWriter.append = _append_and_kill
    vehicle_endpoint.fly_samples = _fly_and_kill
