from gustproof.show.live import telemetry_buffer
from gustproof.show.live.telemetry_buffer import TelemetryBuffer


def test_each_reader_is_told_everything_once():
    told = TelemetryBuffer(phase="ready")
    first = told.reader()
    assert first.read() == {"facts": {"phase": "ready"}}
    told.add("wind", [[0.0, 1.0, 2.0, 3.0]])
    assert first.read() == {"wind": [[0.0, 1.0, 2.0, 3.0]]}
    assert first.read() == {}
    assert told.reader().read() == {"wind": [[0.0, 1.0, 2.0, 3.0]], "facts": {"phase": "ready"}}


def test_facts_are_told_again_only_when_one_has_changed():
    told = TelemetryBuffer(phase="ready", paused=False)
    reader = told.reader()
    reader.read()
    told.update(paused=False)
    assert reader.read() == {}
    told.update(paused=True, mode="OFFBOARD")
    assert reader.read() == {"facts": {"phase": "ready", "paused": True, "mode": "OFFBOARD"}}


def test_of_a_long_flight_the_oldest_rows_go_and_no_new_one_is_missed(monkeypatch):
    monkeypatch.setattr(telemetry_buffer, "_MAX_ROWS", 10)
    told = TelemetryBuffer()
    quick, slow = told.reader(), told.reader()
    quick.read()
    seen = []
    for k in range(25):
        told.add("torque", [[float(k)]])
        seen += quick.read()["torque"]
    assert seen == [[float(k)] for k in range(25)]
    (kept,) = (rows for name, rows in slow.read().items() if name == "torque")
    assert 5 <= len(kept) <= 10
    assert kept == seen[-len(kept) :]


def test_another_flight_drops_the_rows_of_the_one_before():
    buffer = TelemetryBuffer(law="a")
    buffer.add("age", [(0.0, 1.0), (0.1, 2.0)])
    early, late = buffer.reader(), buffer.reader()
    early.read()
    buffer.restart(law="b")
    buffer.add("age", [(0.0, 3.0)])
    expected = {"flight": 2, "age": [(0.0, 3.0)], "facts": {"law": "b"}}
    assert early.read() == late.read() == expected
    assert early.read() == {}
