"""Say that a log is too slow to identify a vehicle from, and which settings of the autopilot cure it."""

from gustproof.logs.identify.stretches import sample_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal

_SLOW = 40.0  # [Hz] below which a refusal is blamed on the rate; logs of PX4's default profile have 50
_CURES = {
    "px4": "set SDLOG_PROFILE 17 and fly again",
    "ardupilot": "set LOG_BITMASK 442367 and LOG_FILE_RATEMAX 0 and fly again",
    "crazyflie": "log at 250 Hz or more",
}


def describe_slow_log(log: FlightLog, command: LogSignal) -> str:
    """Return that gyro or `command` are logged too slowly, with their rates and the cure; empty if they are not."""
    rates = {"gyro": 1.0 / sample_time(log.gyro), "command": 1.0 / sample_time(command)}
    if min(rates.values()) >= _SLOW:
        return ""
    logged = " and ".join(f"{name} at {rate:.3g} Hz" for name, rate in rates.items())
    cure = _CURES.get(log.system, "take the autopilot's own log, at 250 Hz")
    return f"the log is too slow, {logged}: {cure}"
