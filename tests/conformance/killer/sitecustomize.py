"""Kills processes of a flight after an exact number of samples: KILL="controller fly vehicle 1234" in the environment.

Python runs this file at its start if its folder is on PYTHONPATH; it acts in the vehicle's process, or in its copy.
"""

import os
import signal
import sys

if "KILL" in os.environ and {"firmware_model", "gustproof"} & {*sys.orig_argv}:
    import psutil

    from firmware_model.recording.journal import JournalWriter

    *_victims, _moment = os.environ["KILL"].split()
    _append, _flown = JournalWriter.append, 0

    def _kill(victim: str) -> None:
        fly = psutil.Process(os.getppid())
        if victim == "controller":
            (controller,) = [
                child for child in fly.children() if "endpoint" in " ".join([child.name(), *child.cmdline()])
            ]
            controller.kill()
        else:
            os.kill({"fly": fly.pid, "vehicle": os.getpid()}[victim], signal.SIGKILL)

    def _append_and_kill(self, record) -> None:
        global _flown
        _append(self, record)
        _flown += 1
        if _flown == int(_moment):
            for victim in _victims:
                _kill(victim)

    JournalWriter.append = _append_and_kill
