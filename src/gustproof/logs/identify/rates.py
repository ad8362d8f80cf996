"""Rates of logs and loops: say when one is too slow to identify a vehicle from, and which settings cure it."""

from collections.abc import Mapping

from gustproof.logs.identify.stretches import sample_time
from gustproof.logs.read.flight_log import FlightLog, LogSignal

_LOOP_RATES = {
    "px4": ("IMU_GYRO_RATEMAX", 400.0),
    "ardupilot": ("SCHED_LOOP_RATE", 400.0),
    "crazyflie": ("", 500.0),
}
"""Parameter and default [Hz] of the rate of the loops that make the command, by the writer of the log."""
_SPARSE = 1.5  # steps of the loop from one logged sample to the next, from which on some are missing
_SLOW = 40.0  # [Hz] below which a refusal is blamed on the rate; logs of PX4's default profile have 50
_CURES = {
    "px4": "set SDLOG_PROFILE 17",
    "ardupilot": "set LOG_BITMASK 442367 and LOG_FILE_RATEMAX 0",
    "crazyflie": "log gyro and torque command at 250 Hz or more",
}


def loop_rate(log: FlightLog) -> float | None:
    """Return the rate [Hz] of the loops that made the commands of a log, or its default; `None` if unknown."""
    name, usual = _LOOP_RATES.get(log.system, ("", None))
    return log.parameters.get(name, usual)


def is_whole(log: FlightLog, signal: LogSignal | None) -> bool:
    """Return whether a signal of a log is known to have a sample of each turn of the autopilot's loop."""
    rate = log.parameters.get(_LOOP_RATES.get(log.system, ("", 0.0))[0], 0.0)
    return signal is not None and rate > 0.0 and sample_time(signal) * rate < _SPARSE


def is_sparse(log: FlightLog, signal: LogSignal) -> bool:
    """Return whether a signal of a log misses turns of the autopilot's loop."""
    rate = loop_rate(log)
    return rate is not None and sample_time(signal) * rate >= _SPARSE


def describe_cure(log: FlightLog) -> str:
    """Return the settings that make a log fast enough; a telemetry log is not of the autopilot's making."""
    telemetry = "take the log of the autopilot's own card, with gyro and torque command at 250 Hz,"
    return telemetry if log.source.endswith(".tlog") else _CURES.get(log.system, "log gyro and torque at 250 Hz")


def describe_slow_log(log: FlightLog, signals: Mapping[str, LogSignal], least: float = _SLOW) -> str:
    """Return that some of the `signals`, by name, are logged below `least` [Hz], with rates and cure; else nothing."""
    rates = {name: 1.0 / sample_time(signal) for name, signal in signals.items()}
    if min(rates.values()) >= least:
        return ""
    logged = " and ".join(f"{name} at {rate:.3g} Hz" for name, rate in rates.items())
    return f"the log is too slow, {logged}: {describe_cure(log)} and fly again"
