import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import streams
from firmware_model.mavlink.services.service import Service, Stream

SET, GET, ONCE = wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_GET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE
ATTITUDE, HUD = wire.MAVLINK_MSG_ID_ATTITUDE, wire.MAVLINK_MSG_ID_VFR_HUD
INTERVAL = wire.MAVLINK_MSG_ID_MESSAGE_INTERVAL
ACCEPTED, NOT_NOW, DENIED, UNSUPPORTED = 0, 1, 2, 3
PING, TARGET, MODES = wire.MAVLINK_MSG_ID_PING, wire.MAVLINK_MSG_ID_ATTITUDE_TARGET, wire.MAVLINK_MSG_ID_AVAILABLE_MODES


def ping(number: int = 0):
    return wire.MAVLink_ping_message(0, number, 0, 0)


@pytest.fixture
def service(craft):
    craft.services = Service(
        streams={PING: Stream(ping, 1000), TARGET: Stream(lambda: None), ATTITUDE: Stream(ping), HUD: Stream(ping)},
        on_request={MODES: lambda index: [ping(number) for number in (1, 2, 3) if index in (0, number)]},
    )
    return streams.make_service(craft)


@pytest.mark.parametrize(("asked", "kept"), [(5000.0, 5000), (0.0, 0), (-1.0, None)])
def test_interval_is_set(service, order, peer, asked, kept):
    assert order(service, SET, PING, asked) == (ACCEPTED, "")
    assert peer.intervals == {PING: kept}


@pytest.mark.parametrize(
    ("numbers", "result"),
    [
        ((PING, -2.0), DENIED),
        ((PING, None), DENIED),
        ((None, 5.0), DENIED),
        ((-1.0, 5.0), DENIED),  # no such message
        ((wire.MAVLINK_MSG_ID_RC_CHANNELS, 5.0), UNSUPPORTED),  # none that is sent
    ],
)
def test_interval_that_cannot_be_set_is_refused(service, order, peer, numbers, result):
    assert order(service, SET, *numbers) == (result, "")
    assert peer.intervals == {}


@pytest.mark.parametrize(("interval_us", "told"), [(5000, 5000), (None, -1)])
def test_interval_is_told(service, order, peer, interval_us, told):
    peer.intervals[PING] = interval_us
    assert order(service, GET, PING) == (ACCEPTED, "")
    (message,) = peer.take()
    assert (message.message_id, message.interval_us) == (PING, told)


def test_interval_of_a_message_that_is_never_sent_is_unsupported(service, order, peer):
    assert order(service, GET, wire.MAVLINK_MSG_ID_RC_CHANNELS) == (UNSUPPORTED, "")
    assert peer.take() == []


@pytest.mark.parametrize("number", [None, -1.0, 70_000.0])
def test_interval_of_no_message_is_denied(service, order, peer, number):
    assert order(service, GET, number) == (DENIED, "")
    assert peer.sent == []


@pytest.mark.parametrize(("index", "shown"), [(None, [1, 2, 3]), (0.0, [1, 2, 3]), (2.0, [2])])
def test_what_is_shown_takes_an_index(service, order, peer, index, shown):
    assert order(service, ONCE, MODES, index) == (ACCEPTED, "")
    assert [message.seq for message in peer.take()] == shown


@pytest.mark.parametrize(
    ("numbers", "result"),
    [
        ((PING,), ACCEPTED),
        ((TARGET,), NOT_NOW),  # nothing is tracked
        ((MODES, 4.0), NOT_NOW),
        ((None,), DENIED),
        ((-1.0,), DENIED),
        ((2.0**24,), DENIED),
        ((9999.0,), UNSUPPORTED),
        ((397.0,), UNSUPPORTED),
    ],
)
def test_request_of_one_message_is_answered(service, order, peer, numbers, result):
    assert order(service, ONCE, *numbers) == (result, "")
    assert bool(peer.sent) is (result == ACCEPTED)


def test_old_clients_set_the_rates_of_groups(service, ask, peer):
    ask(service, wire.MAVLink_request_data_stream_message(1, 1, wire.MAV_DATA_STREAM_EXTRA1, 4, 1))
    assert peer.intervals == {ATTITUDE: 250_000}
    ask(service, wire.MAVLink_request_data_stream_message(1, 1, wire.MAV_DATA_STREAM_EXTRA1, 4, 0))
    assert peer.intervals == {ATTITUDE: None}
    ask(service, wire.MAVLink_request_data_stream_message(1, 1, wire.MAV_DATA_STREAM_ALL, 2, 1))
    assert peer.intervals == {ATTITUDE: 500_000, HUD: 500_000}  # of all groups, what is told here


@pytest.mark.parametrize(("interval_us", "told"), [(5000, 5000), (None, -1)])
def test_interval_is_requested_like_any_message(service, order, peer, interval_us, told):
    peer.intervals[PING] = interval_us
    assert order(service, ONCE, INTERVAL, PING) == (ACCEPTED, "")
    (message,) = peer.take()
    assert (message.get_type(), message.message_id, message.interval_us) == ("MESSAGE_INTERVAL", PING, told)


@pytest.mark.parametrize(
    ("number", "result"), [(None, DENIED), (-1.0, DENIED), (70_000.0, DENIED), (65.0, UNSUPPORTED)]
)
def test_interval_of_no_message_is_not_requested(service, order, peer, number, result):
    assert order(service, ONCE, INTERVAL, number) == (result, "")
    assert peer.sent == []
