import numpy as np

from gustproof.logs.read.flight_log import FlightLog, LogSignal
from gustproof.show.report.log_summary import doubts, flight_document, summary
from gustproof.studies.logged_flight import LoggedFlight

GYRO = LogSignal(time=np.arange(0.0, 5.0, 0.1), values=np.zeros((50, 3)))


def test_what_leaves_no_verdict_is_said_once():
    log = FlightLog(source="a.ulg", system="px4", gyro=GYRO, findings=("gyro: 10 Hz; identification needs 100 Hz",))
    reason = "a.ulg: never in the air, by its landing detector"
    flight = LoggedFlight(log=log, no_vehicle=reason, no_judgement=f"no vehicle: {reason}")
    said = [*summary(flight), *doubts(flight)]
    assert sum("never in the air" in line for line in said) == 1
    assert doubts(flight) == log.findings
    assert flight_document(flight)["findings"] == [*log.findings, reason]
