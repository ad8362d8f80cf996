import socket
from itertools import pairwise

import pytest

from firmware_model.errors import ConfigError
from firmware_model.mavlink.frames import RejectReason
from firmware_model.process import udp


class Echo:
    """Sends one datagram to itself, and has finished when it is back."""

    def __init__(self, port: int) -> None:
        self.address = ("127.0.0.1", port)
        self.outbox: list = [(b"there and back", (0, self.address))]
        self.received: list = []
        self.dropped: list = []

    @property
    def finished(self) -> bool:
        return bool(self.received)

    def count_reject(self, cause, peer):
        self.dropped.append((cause, peer))

    def receive(self, datagram, peer, now_us):
        self.received.append((datagram, peer, now_us))

    def poll(self, now_us):
        outbox, self.outbox = self.outbox, []
        self.now_us = now_us
        return outbox

    def deadline_us(self) -> int:
        return self.now_us + 1_000_000


def alone(endpoint, bound) -> None:
    udp.serve(endpoint, [bound])


def connected(endpoint, bound) -> None:
    udp.connect(bound, bound.getsockname())
    udp.serve_lockstep(endpoint, bound)


carried = pytest.mark.parametrize("carry", [alone, udp.serve_lockstep, connected])


@carried
def test_datagrams_are_carried_with_their_peer_and_a_time(carry):
    with udp.bind(0) as bound:
        echo = Echo(bound.getsockname()[1])
        carry(echo, bound)
    ((datagram, peer, now_us),) = echo.received
    assert (datagram, peer) == (b"there and back", (0, echo.address))
    assert now_us <= echo.now_us


@carried
def test_datagram_that_cannot_be_sent_is_lost_and_no_more(carry):
    with udp.bind(0) as bound:
        echo = Echo(bound.getsockname()[1])
        echo.outbox.insert(0, (bytes(70_000), (0, echo.address)))
        carry(echo, bound)
    assert len(echo.received) == 1


class Clock(Echo):
    """Sends nothing and has finished at its third deadline."""

    def __init__(self) -> None:
        self.polls = 0

    @property
    def finished(self) -> bool:
        return self.polls == 3

    def poll(self, now_us):
        self.polls += 1
        self.now_us = now_us
        return []

    def deadline_us(self) -> int:
        return self.now_us + 500


class Rally(Echo):
    """Returns what it gets, and has finished when it has it for the third time."""

    @property
    def finished(self) -> bool:
        return len(self.received) == 3

    def receive(self, datagram, peer, now_us):
        super().receive(datagram, peer, now_us)
        self.outbox.append((datagram, peer))


@pytest.fixture
def watches(monkeypatch):
    """Calls of `_watch`: waits without falling asleep."""
    calls: list = []
    watch = udp._spin_readable
    monkeypatch.setattr(udp, "_spin_readable", lambda sockets, end_us: calls.append(end_us) or watch(sockets, end_us))
    return calls


def test_where_nothing_comes_at_once_the_next_waits_are_slept_through(watches, monkeypatch):
    monkeypatch.setattr(udp, "_SPIN_WAIT_US", 0)
    with udp.bind(0) as bound:
        udp.serve(Clock(), [bound])
    assert len(watches) == 1


def test_every_quick_answer_is_awaited_without_falling_asleep(watches, monkeypatch):
    monkeypatch.setattr(udp, "_SPIN_WAIT_US", 60_000_000)  # longer than a busy machine holds a process up
    with udp.bind(0) as bound:
        udp.serve(Rally(bound.getsockname()[1]), [bound])
    assert len(watches) == 3


@carried
def test_deadlines_are_met_while_nobody_speaks(carry):
    with udp.bind(0) as bound:
        clock = Clock()
        carry(clock, bound)
    assert clock.polls == 3


@carried
def test_deadlines_are_met_after_the_other_has_fallen_silent(carry):
    class Silent(Echo):
        """Has its echo, and has finished at a deadline after that."""

        @property
        def finished(self) -> bool:
            return bool(self.received) and self.now_us > self.received[0][2] + 10_000

        def deadline_us(self) -> int:
            return self.now_us + 1_000

    with udp.bind(0) as bound:
        silent = Silent(bound.getsockname()[1])
        carry(silent, bound)
    assert len(silent.received) == 1


def test_connected_socket_hears_nobody_else():
    with udp.bind(0) as bound, udp.bind(0) as stranger:
        echo = Echo(bound.getsockname()[1])
        udp.connect(bound, bound.getsockname())
        stranger.sendto(b"hello", bound.getsockname())
        udp.serve_lockstep(echo, bound)
    assert [datagram for datagram, _, _ in echo.received] == [b"there and back"]


def test_address_without_a_way_there_is_told_in_one_line():
    with udp.bind(0) as bound, pytest.raises(ConfigError, match=r"255\.255\.255\.255"):
        udp.connect(bound, ("255.255.255.255", 9))


def test_refusal_of_what_was_sent_is_not_an_arrival():
    with udp.bind(0) as bound:
        with udp.bind(0) as gone:
            address = gone.getsockname()
        udp.connect(bound, address)
        clock = Clock()
        clock.poll(0)
        bound.send(b"is anybody there?")
        udp.serve_lockstep(clock, bound)
    assert clock.polls == 3


def test_port_in_use_is_told_in_one_line():
    with udp.bind(0) as bound:
        port = bound.getsockname()[1]
        with pytest.raises(ConfigError, match=f"can't listen on UDP port {port}: Address already in use"):
            udp.bind(port)


def test_number_that_is_no_port_is_refused():
    with pytest.raises(ConfigError, match="70000"):
        udp.bind(70_000)


def test_unknown_host_is_refused(monkeypatch):
    def unknown(_):
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "gethostbyname", unknown)
    with pytest.raises(ConfigError, match="nowhere"):
        udp.resolve("nowhere", 1)


class Patient(Echo):
    """Sends nothing and has finished when it has heard everybody in `awaited`."""

    def __init__(self, awaited) -> None:
        self.outbox, self.received, self.dropped, self.awaited = [], [], [], set(awaited)

    @property
    def finished(self) -> bool:
        return self.awaited <= {address for _, (_, address), _ in self.received}


def lockstep(endpoint, bound) -> None:
    udp.serve_lockstep(endpoint, bound)


def in_real_time(endpoint, bound) -> None:
    udp.serve(endpoint, [bound], real_time=True)


unconnected = pytest.mark.parametrize("carry", [alone, in_real_time, lockstep])


@unconnected
def test_peer_that_floods_keeps_nobody_else_out(carry):
    with udp.bind(0) as bound, udp.bind(0) as flooder, udp.bind(0) as modest:
        flood = flooder.getsockname()
        for _ in range(150):
            flooder.sendto(b"flood", bound.getsockname())
        modest.sendto(b"please", bound.getsockname())
        endpoint = Patient([modest.getsockname()])
        carry(endpoint, bound)
    heard = [address for _, (_, address), _ in endpoint.received]
    # One in each cycle until the socket is emptied, and then its share.
    least = udp._DRAIN_CYCLES - 1 + udp._PEER_LIMIT
    assert least <= heard.count(flood) <= least + 2
    assert endpoint.dropped == []


class Counting(Patient):
    """Has finished when it has heard so many datagrams; notes how many came between two polls."""

    def __init__(self, awaited: int) -> None:
        super().__init__(())
        self.count, self.polled = awaited, [0]

    @property
    def finished(self) -> bool:
        return len(self.received) + len(self.dropped) >= self.count

    def poll(self, now_us):
        self.polled.append(len(self.received))
        return super().poll(now_us)


@unconnected
def test_all_that_peers_say_at_once_is_heard_in_order_and_in_turn(carry):
    with udp.bind(0) as bound, udp.bind(0) as first, udp.bind(0) as second:
        for number in range(100):
            for speaker in (first, second):
                speaker.sendto(bytes([number]), bound.getsockname())
        endpoint = Counting(200)
        carry(endpoint, bound)
    by_peer: dict = {}
    for datagram, peer, _ in endpoint.received:
        by_peer.setdefault(peer, []).append(datagram)
    assert list(by_peer.values()) == [[bytes([number]) for number in range(100)]] * 2
    assert max(after - before for before, after in pairwise(endpoint.polled)) <= 2 * (udp._PEER_LIMIT + 1) + 1


@unconnected
def test_datagrams_beyond_what_may_wait_are_discarded_and_counted(carry, monkeypatch):
    monkeypatch.setattr(udp, "_PEER_QUEUE", 20)
    with udp.bind(0) as bound, udp.bind(0) as flooder:
        flood = flooder.getsockname()
        for number in range(150):
            flooder.sendto(bytes([number]), bound.getsockname())
        endpoint = Counting(150)
        carry(endpoint, bound)
    assert 30 <= len(endpoint.received) <= 60
    assert set(endpoint.dropped) == {(RejectReason.RATE_LIMITED, (0, flood))}
    heard = [datagram for datagram, _, _ in endpoint.received]
    assert heard == sorted(heard)


def test_what_is_due_is_done_between_any_two_datagrams_of_a_flood():
    class Polled(Patient):
        polls = 0

        def poll(self, now_us):
            self.polls += 1
            return super().poll(now_us)

    with udp.bind(0) as bound, udp.bind(0) as flooder, udp.bind(0) as modest:
        for _ in range(udp._DRAIN_CYCLES - 2):
            flooder.sendto(b"flood", bound.getsockname())
        modest.sendto(b"please", bound.getsockname())
        endpoint = Polled([modest.getsockname()])
        udp.serve(endpoint, [bound])
    assert endpoint.polls == len(endpoint.received) + 1


class Hung(Echo):
    """Has finished when a number of datagrams is there, or none comes; notes how many were when it was polled."""

    def __init__(self, port: int, awaited: int) -> None:
        super().__init__(port)
        self.outbox = []
        self.awaited = awaited
        self.polled: list[int] = []

    @property
    def finished(self) -> bool:
        return len(self.received) >= self.awaited or self.polled[-2:] == [len(self.received)] * 2

    def poll(self, now_us):
        self.polled.append(len(self.received))
        return super().poll(now_us)


def test_connected_socket_hands_over_all_that_gathered_in_order_before_it_polls(monkeypatch):
    monkeypatch.setattr(udp, "_SPIN_WAIT_US", -1)  # however soon the process is there
    said = [bytes([number]) for number in range(250)]
    with udp.bind(0) as bound, udp.bind(0) as vehicle:
        udp.connect(bound, vehicle.getsockname())
        for datagram in said:
            vehicle.sendto(datagram, bound.getsockname())
        endpoint = Hung(bound.getsockname()[1], len(said))
        udp.serve_lockstep(endpoint, bound)
    assert [datagram for datagram, _, _ in endpoint.received] == said
    assert endpoint.polled == [0, len(said)]
    assert endpoint.dropped == []


def test_connected_socket_keeps_a_second_of_a_vehicles_streams():
    with udp.bind(0) as bound, udp.bind(0) as vehicle:
        usual = bound.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        udp.connect(bound, vehicle.getsockname())
        for _ in range(500):
            vehicle.sendto(bytes(74), bound.getsockname())
        endpoint = Hung(bound.getsockname()[1], 500)
        udp.serve_lockstep(endpoint, bound)
        assert len(endpoint.received) == 500
        assert bound.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) > usual


@pytest.mark.parametrize(("host", "alone"), [("127.0.0.1", True), ("127.0.7.1", True), ("0.0.0.0", False)])
def test_loopback_is_this_machine_alone(host, alone):
    assert udp.is_loopback(host) is alone


class Oversleeping:
    """A clock that sleep moves too far, and a look at it or at the sockets a little; nothing ever comes."""

    LOOK_US, OVERSLEPT_US = 1, 120

    def __init__(self) -> None:
        self.now_us = 1_000_000
        self.slept_us: list[int] = []

    def look(self) -> int:
        self.now_us += self.LOOK_US
        return self.now_us

    def select(self, readers, writers, errors, timeout_s):
        slept_us = round(timeout_s * 1e6)
        self.slept_us.append(slept_us)
        self.now_us += slept_us + self.OVERSLEPT_US if slept_us else self.LOOK_US
        return [], [], []


class Beats(Echo):
    """Is to be polled every `period_us` on the clock, and notes how late it is; has finished after a hundred times."""

    def __init__(self, now_us: int, period_us: int) -> None:
        self.due_us, self.period_us = now_us + period_us, period_us
        self.late_us: list[int] = []

    @property
    def finished(self) -> bool:
        return len(self.late_us) == 100

    def poll(self, now_us):
        if now_us >= self.due_us:
            self.late_us.append(now_us - self.due_us)
            self.due_us += self.period_us
        return []

    def deadline_us(self) -> int:
        return self.due_us


@pytest.fixture
def clock(monkeypatch):
    clock = Oversleeping()
    monkeypatch.setattr(udp, "_now_us", clock.look)
    monkeypatch.setattr(udp.select, "select", clock.select)
    return clock


@pytest.mark.parametrize("period_us", [1_000, 4_000])
def test_punctual_endpoint_is_served_when_it_is_time_however_long_waking_takes(clock, period_us):
    beats = Beats(clock.now_us, period_us)
    udp.serve(beats, [], real_time=True)
    assert max(beats.late_us) <= 3 * clock.LOOK_US
    assert sum(clock.slept_us) >= 100 * (period_us - udp._SPIN_US - 10 * clock.LOOK_US)  # all but the last stretch


def test_other_endpoints_sleep_to_the_end(clock, monkeypatch):
    monkeypatch.setattr(udp, "_SPIN_WAIT_US", 0)
    beats = Beats(clock.now_us, 4_000)
    udp.serve(beats, [])
    assert min(beats.late_us) >= clock.OVERSLEPT_US - 10 * clock.LOOK_US
    assert clock.slept_us.count(0) <= 2


def test_who_is_late_still_listens_in_every_cycle(clock):
    beats = Beats(clock.now_us - 400_000, 1_000)
    udp.serve(beats, [], real_time=True)
    assert clock.slept_us.count(0) >= 99


def test_datagram_that_comes_in_the_last_stretch_is_taken_before_the_deadline(monkeypatch):
    monkeypatch.setattr(udp, "_SPIN_US", 60_000_000)
    with udp.bind(0) as bound:
        echo = Echo(bound.getsockname()[1])
        echo.deadline_us = lambda: echo.now_us + 50_000_000
        udp.serve(echo, [bound], real_time=True)
    ((_, _, now_us),) = echo.received
    assert now_us < echo.now_us + 50_000_000
