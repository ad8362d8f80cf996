"""Say that a log is too slow to identify a vehicle from, and which settings of the autopilot cure it."""

from collections.abc import Mapping

from gustproof.logs.identify.stretches import sample_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal

_SLOW = 40.0  # [Hz] below which a refusal is blamed on the rate; logs of PX4's default profile have 50
_CURES = {
    "px4": "set SDLOG_PROFILE 17 and fly again",
    "ardupilot": "set LOG_BITMASK 442367 and LOG_FILE_RATEMAX 0 and fly again",
    "crazyflie": "log at 250 Hz or more",
}


def describe_slow_log(log: FlightLog, signals: Mapping[str, LogSignal], least: float = _SLOW) -> str:
    """Return that some of the `signals`, by name, are logged below `least` [Hz], with rates and cure; else nothing."""
    rates = {name: 1.0 / sample_time(signal) for name, signal in signals.items()}
    if min(rates.values()) >= least:
        return ""
    logged = " and ".join(f"{name} at {rate:.3g} Hz" for name, rate in rates.items())
    cure = _CURES.get(log.system, "take the autopilot's own log, at 250 Hz")
    return f"the log is too slow, {logged}: {cure}"
