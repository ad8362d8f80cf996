"""Client of plain sockets that flies the vehicle `paper`: `raw_client.py [FAULT]`, sound, or with one fault."""

import math
import os
import socket
import struct
import sys
import time

GAINS = ((2.2, 1.2), (1.8, 1.0), (0.9, 0.5))  # [N m/rad], [N m s/rad] about roll, pitch and yaw
LIMIT = 10.0  # [N m] of the vehicle 'paper'
EXTRA = {0: 50, 76: 152, 139: 168, 150: 134}  # seeds of the checksums
FAULT = sys.argv[1] if len(sys.argv) > 1 else ""
FACTORS = {"wrong-units": math.degrees(1.0), "wrong-sign": -1.0}
HOST, PORT = os.environ["GUSTPROOF_ADDRESS"].split(":")
LINK = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
LINK.connect((HOST, int(PORT)))
LINK.settimeout(0.1)
SYSTEM = 42 if FAULT == "wrong-system-id" else 1
COMPONENT = 25 if FAULT == "wrong-component-id" else 191
sequence = 0


def send(number: int, payload: bytes) -> None:
    """Send a message as a MAVLink 2 frame."""
    global sequence
    head = struct.pack("<BBBBBBHB", len(payload), 0, 0, sequence & 255, SYSTEM, COMPONENT, number & 0xFFFF, 0)
    sequence += 1
    crc = 0xFFFF
    for byte in head + payload + bytes([EXTRA[number]]):
        x = (byte ^ crc) & 255
        x = (x ^ x << 4) & 255
        crc = (crc >> 8 ^ x << 8 ^ x << 3 ^ x >> 4) & 0xFFFF
    crc ^= FAULT == "damaged-message"
    LINK.send(b"\xfd" + head + payload + struct.pack("<H", crc))


def order(command: int, *numbers: float) -> None:
    """Send COMMAND_LONG."""
    send(76, struct.pack("<7fHBBB", *numbers, *[0.0] * (7 - len(numbers)), command, 1, 1, 0))


def answer(stamp_us: int, torque: list[float]) -> None:
    """Send the set-point for a sample."""
    if FAULT == "silent":
        return
    throttle = math.nan
    if stamp_us > 400_000:
        torque = [math.nan] * 3 if FAULT == "not-finite" else torque
        throttle = 1.5 if FAULT == "out-of-range" and stamp_us < 410_000 else throttle
    if FAULT == "wrong-stamp":
        stamp_us = time.monotonic_ns() // 1000
    if FAULT == "late":
        time.sleep(0.03)
    for _ in range(10 if FAULT == "flooding" else 1):
        send(139, struct.pack("<Q8fBBB", stamp_us, *torque, throttle, *[0.0] * 4, FAULT == "no-thrust", 1, 1))


def begin() -> None:
    """Ask for what begins the flight."""
    if FAULT != "never-arms":
        order(400, 1.0)
    if FAULT == "refused-command":
        order(31_000)
    if FAULT != "never-offboard":
        order(176, 1.0, 6.0)


def fly() -> None:
    """Fly until the vehicle is disarmed."""
    angle, torque, stamp_us, beat_s, steps = [0.0] * 3, [0.0] * 3, -1, -math.inf, 0
    while True:
        if time.monotonic() > beat_s + 1.0:
            beat_s = time.monotonic()
            if FAULT == "no-heartbeat":
                order(400, 1.0)
            else:
                send(0, struct.pack("<IBBBBB", 0, 18, 8, 0, 4, 3))
        try:
            frame = LINK.recv(300)
        except TimeoutError:
            continue
        payload = frame[10 : 10 + frame[1]].ljust(70, b"\0")
        if frame[7] == 0 and stamp_us > 0 and not payload[6] & 128:
            return
        if frame[7] != 105:
            continue
        time_us, *rates = struct.unpack_from("<Q12x3f", payload)
        repeated = time_us == stamp_us
        if repeated and FAULT == "ignores-repeats" and time_us > 0:
            continue
        if not repeated or FAULT == "unequal-answers":
            step_s = 4e-3 if stamp_us >= 0 else 0.0
            angle = [each + step_s * rate for each, rate in zip(angle, rates, strict=True)]
            parts = zip(GAINS, angle, rates, strict=True)
            torque = [-FACTORS.get(FAULT, 1.0) * (k * each + d * rate) / LIMIT for (k, d), each, rate in parts]
        stamp_us, steps = time_us, steps + 1
        if FAULT in ACTS and time_us > 400_000:
            ACTS[FAULT]()
        answer(stamp_us, torque)
        if stamp_us == 0:
            begin()


def die() -> None:
    """End in mid-flight."""
    sys.exit("ValueError: the solver found no solution")


ACTS = {
    "died": die,
    "hung": lambda: time.sleep(60.0),
    "left-offboard": lambda: order(176, 1.0, 7.0),
    "unknown-message": lambda: send(150, bytes(42)),
}

fly()
