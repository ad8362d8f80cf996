from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.peers import PeerTable

IMU = wire.MAVLINK_MSG_ID_HIGHRES_IMU
ADDRESS = (0, ("127.0.0.1", 14540))
SAMPLE_US = 4000


def streaming():
    """Return a peer whose IMU stream of every sample has just sent the first."""
    peer = PeerTable(1, None, {IMU: 20_000}, [ADDRESS], min_interval_us=SAMPLE_US).get_or_add(ADDRESS)
    peer.set_interval(IMU, SAMPLE_US, clock_us=0)
    assert peer.take_due(0) == [IMU]
    return peer


def test_peer_that_repeats_its_request_gets_no_sample_twice():
    peer = streaming()
    peer.set_interval(IMU, SAMPLE_US, clock_us=100)
    assert peer.take_due(100) == []
    assert peer.take_due(SAMPLE_US) == [IMU]


def test_peer_that_asks_for_a_faster_stream_waits_no_longer_than_its_interval():
    peer = streaming()
    peer.set_interval(IMU, 40_000, clock_us=SAMPLE_US)
    assert peer.take_due(SAMPLE_US) == [IMU]
    peer.set_interval(IMU, SAMPLE_US, clock_us=2 * SAMPLE_US)
    assert peer.take_due(2 * SAMPLE_US) == []
    assert peer.take_due(3 * SAMPLE_US) == [IMU]


def test_peer_gets_a_stream_that_was_off_at_once():
    peer = streaming()
    peer.set_interval(IMU, None, clock_us=100)
    assert peer.next_us > 10 * SAMPLE_US
    peer.set_interval(IMU, 0, clock_us=200)
    assert peer.take_due(200) == [IMU]
