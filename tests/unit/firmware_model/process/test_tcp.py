import socket
from collections.abc import Iterator
from contextlib import closing
from threading import Thread

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.process import tcp


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with closing(socket.socket()) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        listening.settimeout(20.0)
        yield listening


class Asker:
    """Sends a request each time it is asked, and has finished with the answer; it gives up after some polls."""

    def __init__(self, most: int = 1000) -> None:
        self.polls, self.most = 0, most
        self.received: list[bytes] = []

    @property
    def finished(self) -> bool:
        return bool(self.received) or self.polls > self.most

    def count_reject(self, cause, peer) -> None:
        raise AssertionError

    def receive(self, datagram, peer, now_us) -> None:
        self.received.append(datagram)

    def poll(self, now_us):
        self.polls, self.now_us = self.polls + 1, now_us
        return [(b"request", (0, ("anyone", 1)))]

    def deadline_us(self) -> int:
        return self.now_us + 20_000


def frame() -> bytes:
    return wire.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(wire.MAVLink(None, 1, 1))


def test_frames_of_a_stream_are_passed_on_whole_and_a_lost_connection_is_opened_again(server):
    told: list[str] = []
    asker = Asker()

    def answer() -> None:
        server.accept()[0].close()
        with closing(server.accept()[0]) as link:
            while not asker.finished and link.recv(100):
                link.sendall(b"rubbish" + frame()[:9])
                link.sendall(frame()[9:])
            while link.recv(100):  # until the other side has closed
                pass

    peer = Thread(target=answer)
    peer.start()
    tcp.serve(asker, server.getsockname(), told.append)
    peer.join(20.0)
    assert asker.received[0] == frame()
    (lost,) = told  # closed, or reset if it had not read all
    assert lost.endswith("; trying again")


def test_refused_connection_ends_with_the_endpoint_and_is_told_once(server):
    address = server.getsockname()
    server.close()
    told: list[str] = []
    tcp.serve(Asker(most=5), address, told.append)
    assert told == [f"TCP {address[0]}:{address[1]}: Connection refused; trying again"]
