from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import RejectReason, parse
from firmware_model.mavlink.messages import CONTROLLER
from firmware_model.mavlink.peers import Client, PeerTable

IMU, ATTITUDE = wire.MAVLINK_MSG_ID_HIGHRES_IMU, wire.MAVLINK_MSG_ID_ATTITUDE
GROUND_STATION = 190
ADDRESS = (0, ("127.0.0.1", 14540))
SAMPLE_US = 4000
MAX_PEERS, PEER_TIMEOUT_US, STICKS_US = 16, 10_000_000, 10_000_000
HEARTBEAT = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


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


def table(*expected) -> PeerTable:
    return PeerTable(1, None, {IMU: 20_000, ATTITUDE: 10_000}, expected, min_interval_us=SAMPLE_US)


def speak(peer, component: int, *, lockstep: bool = False, clock_us: int = 0) -> None:
    """Let a peer identify itself by a frame of a component."""
    (frame,) = parse(HEARTBEAT.pack(wire.MAVLink(None, 1, component)))
    peer.identify(frame, lockstep=lockstep, clock_us=clock_us)
    peer.last_seen_us = clock_us
    peer.channel.count(frame)


def test_kind_of_peer_decides_its_streams_once():
    peers = table()
    station, controller, lockstep = (peers.get_or_add((0, ("host", port))) for port in (1, 2, 3))
    speak(station, GROUND_STATION)
    speak(controller, CONTROLLER)
    speak(lockstep, CONTROLLER, lockstep=True)
    kinds = [(peer.interval_us(IMU), peer.interval_us(ATTITUDE)) for peer in (station, controller, lockstep)]
    assert kinds == [(20_000, 10_000), (SAMPLE_US, 10_000), (20_000, None)]
    assert [peer.is_samples_only for peer in (station, controller, lockstep)] == [False, False, True]
    station.set_interval(ATTITUDE, None, clock_us=0)
    speak(station, GROUND_STATION)  # its wish is kept
    assert station.interval_us(ATTITUDE) is None
    speak(station, CONTROLLER)  # a controller behind the same address gets a controller's streams
    assert (station.interval_us(IMU), station.interval_us(ATTITUDE)) == (SAMPLE_US, 10_000)
    speak(station, GROUND_STATION)
    assert station.interval_us(IMU) == SAMPLE_US


def test_missed_messages_are_not_made_up_for():
    peer = table().get_or_add(ADDRESS)
    peer.set_interval(IMU, SAMPLE_US, clock_us=0)
    assert peer.take_due(0) == [IMU]
    assert peer.take_due(2 * SAMPLE_US) == [IMU]
    assert peer.take_due(2 * SAMPLE_US) == []
    assert peer.next_us == 3 * SAMPLE_US
    assert peer.take_due(3 * SAMPLE_US - 1) == []
    assert peer.take_due(3 * SAMPLE_US) == [IMU]


def test_silent_peer_goes_and_its_packets_stay_in_the_sum():
    peers = table()
    peer = peers.get_or_add(ADDRESS)
    speak(peer, GROUND_STATION)
    peer.channel.pack(HEARTBEAT)
    assert peers.remove_silent(PEER_TIMEOUT_US) == []
    assert peers.remove_silent(PEER_TIMEOUT_US + 1) == [peer]
    assert list(peers) == []
    assert peers.stats() == {"gone": {"in": 1, "out": 1, "lost": 0, "bad": 0, "rejected": {}}}


def test_silent_peer_that_is_expected_stays_without_streams():
    peers = table(ADDRESS)
    peer = peers.get_or_add(ADDRESS)
    assert peers.remove_silent(10 * PEER_TIMEOUT_US) == []  # it never spoke
    speak(peer, CONTROLLER)
    assert peers.remove_silent(10 * PEER_TIMEOUT_US) == [peer]
    assert list(peers) == [peer]
    assert (peer.controller, peer.last_seen_us, peer.interval_us(IMU)) == (False, None, None)
    assert peer.take_due(100 * PEER_TIMEOUT_US) == []
    speak(peer, GROUND_STATION)
    assert peer.interval_us(IMU) == 20_000


def test_rejects_are_counted_for_known_peers_only():
    peers = table()
    peers.get_or_add(ADDRESS)
    peers.count_reject(RejectReason.STALE, ADDRESS)
    peers.count_reject(RejectReason.STALE, (0, ("stranger", 1)))
    assert peers.stats() == {"127.0.0.1:14540": {"in": 0, "out": 0, "lost": 0, "bad": 0, "rejected": {"stale": 1}}}


def test_full_table_takes_no_further_peer():
    peers = table(*((0, ("host", port)) for port in range(MAX_PEERS)))
    assert peers.get_or_add(ADDRESS) is None
    assert peers.get_or_add((0, ("host", 0))) is not None


def test_each_component_numbers_its_own_messages_to_a_peer():
    peer = table().get_or_add(ADDRESS)
    sent = [parse(peer.pack(HEARTBEAT, component))[0] for component in (1, CONTROLLER, 1, CONTROLLER, CONTROLLER)]
    assert [(frame.component, frame.sequence) for frame in sent] == [(1, 0), (191, 0), (1, 1), (191, 1), (191, 2)]
    assert peer.channel.stats()["out"] == 5


def test_sticks_count_for_ten_seconds():
    peer = table().get_or_add(ADDRESS)
    assert not Client(peer, [], 0, 1).moves_sticks
    Client(peer, [], 1_000, 1).note_sticks()
    assert Client(peer, [], 1_000 + STICKS_US - 1, 1).moves_sticks
    assert not Client(peer, [], 1_000 + STICKS_US, 1).moves_sticks


def test_a_peer_of_mavlink_1_is_told_once_that_messages_are_not_sent():
    (peer,), outbox = table(ADDRESS), []
    (frame,) = parse(HEARTBEAT.pack(wire.MAVLink(None, 1, GROUND_STATION), force_mavlink1=True))
    peer.channel.count(frame)
    for _ in range(2):
        peer.post(wire.MAVLink_hil_state_quaternion_message(0, [1.0, 0, 0, 0], *[0.0] * 3, *[0] * 11), outbox)
        peer.post(wire.MAVLink_open_drone_id_arm_status_message(0, b""), outbox)
    kinds = [parse(datagram)[0].message().get_type() for datagram, _ in outbox]
    assert kinds == ["HIL_STATE_QUATERNION", "STATUSTEXT", "HIL_STATE_QUATERNION"]
