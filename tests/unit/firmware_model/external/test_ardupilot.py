"""The JSON interface by hand-made bytes: frames in, answers out."""

import json
import math
import struct
from dataclasses import replace

import pytest

from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.external.ardupilot import FrameKind, FrameReader, ServoFrame, encode_answer, map_outputs
from firmware_model.external.readings import Readings

READINGS = Readings(
    time_us=2_500,
    gyro_B=(0.5, -0.25, 0.125),
    specific_force_B=(0.0, 0.0, -9.75),
    field_B=(0.2, 0.0, 0.4),
    pressure=950.0,
    temperature=11.0,
    gps_position_N=(9.0, 9.0, 9.0),
    gps_velocity_N=(8.0, 8.0, 8.0),
    position_N=(1.0, 2.0, -10.0),
    velocity_N=(0.5, 0.0, 0.25),
    q_NB=(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)),
    omega_B=(0.0, 0.0, 0.0),
    wind_N=(0.5, -3.0, 0.0),
)


def frame(count: int, pulses: list[int], *, magic: int = 18458, outputs: int = 16, rate: int = 400) -> bytes:
    return struct.pack(f"<HHI{outputs}H", magic, rate, count, *pulses, *[1500] * (outputs - len(pulses)))


def test_frame_gives_fractions_in_the_order_of_the_vehicle_file() -> None:
    reader = FrameReader((1, 0, 3, 2))
    assert reader.read(frame(0, [1000, 1250, 2000, 1500])) == ServoFrame(FrameKind.NEW, (0.25, 0.0, 0.5, 1.0), 400)


def test_frame_of_32_outputs_is_read_by_its_own_number() -> None:
    reader = FrameReader((0, 1, 2, 3))
    wide = frame(0, [1100, 1200, 1300, 1400], magic=29569, outputs=32)
    assert reader.read(wide).rotors == pytest.approx((0.1, 0.2, 0.3, 0.4))
    assert reader.read(frame(1, [1500], magic=18458, outputs=32)).kind is FrameKind.FOREIGN


@pytest.mark.parametrize("pulse", [0, 900, 1000])
def test_output_below_the_range_is_no_thrust(pulse: int) -> None:
    assert FrameReader((0,)).read(frame(0, [pulse])).rotors == (0.0,)


def test_output_above_the_range_is_the_largest_thrust() -> None:
    assert FrameReader((0,)).read(frame(0, [2100])).rotors == (1.0,)


def test_repeated_count_asks_again_and_lower_count_is_a_restart() -> None:
    reader = FrameReader((0,))
    kinds = [reader.read(frame(count, [1500])).kind for count in (0, 1, 1, 2, 0)]
    new, again = FrameKind.NEW, FrameKind.REPEATED
    assert kinds == [new, new, again, new, FrameKind.RESTARTED]


@pytest.mark.parametrize("datagram", [b"", b"x", bytes(40), bytes(72), frame(0, [1500])[:-1], frame(0, [1500]) + b"x"])
def test_other_datagrams_are_foreign(datagram: bytes) -> None:
    assert FrameReader((0,)).read(datagram).kind is FrameKind.FOREIGN


def test_answer_holds_each_reading_under_its_name() -> None:
    answer = json.loads(encode_answer(READINGS))
    assert answer["timestamp"] == 0.002501001
    assert answer["imu"] == {"gyro": [0.5, -0.25, 0.125], "accel_body": [0.0, 0.0, -9.75]}
    assert answer["position"] == [1.0, 2.0, -10.0]
    assert answer["velocity"] == [0.5, 0.0, 0.25]
    assert answer["quaternion"] == pytest.approx([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)], abs=1e-8)
    assert answer["rng_1"] == 10.0
    assert answer["velocity_wind"] == [0.5, -3.0, 0.0]


def test_wind_vane_points_where_the_air_comes_from() -> None:
    # The nose points east and the air comes from there: at 3 m/s, from straight ahead.
    vane = json.loads(encode_answer(READINGS))["windvane"]
    assert vane == {"direction": pytest.approx(0.0, abs=1e-6), "speed": 3.0}
    # It moves north at 2 m/s through still air: the air comes from the left.
    north = READINGS._replace(velocity_N=(2.0, 0.0, 0.0), wind_N=(0.0, 0.0, 0.0))
    vane = json.loads(encode_answer(north))["windvane"]
    assert vane == {"direction": pytest.approx(-0.5 * math.pi, abs=1e-6), "speed": 2.0}


def test_answer_suits_a_reader_that_takes_the_first_name_and_skips_two_characters() -> None:
    text = encode_answer(READINGS)
    for name, first in (
        ("timestamp", b"0.002501"),
        ("gyro", b"[0.5,"),
        ("velocity", b"[0.5,0,"),
        ("quaternion", b"[0.7"),
    ):
        place = text.index(name.encode()) + len(name) + 2
        assert text[place : place + len(first)] == first
    assert text[:1] == text[-1:] == b"\n"


@pytest.mark.parametrize("step", [1, 7, 4_000, 400_000, 34_000_001])
def test_difference_of_stamps_is_never_cut_below_a_sample(step: int) -> None:
    # The autopilot cuts it to whole microseconds: 2499 would cost it a pass of its loop.
    earlier, later = (
        json.loads(encode_answer(READINGS._replace(time_us=2_500 * number)))["timestamp"] for number in (step - 1, step)
    )
    assert int((later - earlier) * 1e6) == 2_500


def test_float32_values_pass_unchanged() -> None:
    value = struct.unpack("<f", struct.pack("<f", 0.1))[0]
    answer = json.loads(encode_answer(READINGS._replace(gyro_B=(value, -value, value / 3e5))))
    gyro = answer["imu"]["gyro"]
    assert struct.pack("<3f", *gyro) == struct.pack("<3f", value, -value, value / 3e5)


@pytest.mark.parametrize(
    "value", [0.0, 1e-9, 2 / 3e4, 0.0999999999, 0.99999999951, 1 / 3, 9.81, 123456.789, 987654321.0]
)
def test_number_has_nine_digits(value: float) -> None:
    answer = json.loads(encode_answer(READINGS._replace(position_N=(value, -value, 1.0))))
    assert answer["position"] == [float(f"{value:.9g}"), -float(f"{value:.9g}"), 1.0]


@pytest.mark.parametrize("value", [1e9, 1e300, math.inf, math.nan])
def test_number_beyond_nine_digits_is_told_as_their_end(value: float) -> None:
    answer = json.loads(encode_answer(READINGS._replace(velocity_N=(value, 1e-18, 0.0), wind_N=(0.0, 0.0, 0.0))))
    assert answer["velocity"] == [1e9, 0.0, 0.0]
    assert answer["windvane"]["speed"] == 1e9


def test_rotors_are_mapped_by_their_place() -> None:
    vehicle = load_vehicle("paper")
    assert map_outputs(vehicle) == (0, 1, 2, 3)
    rotors = vehicle.rotors
    order = (3, 2, 1, 0)
    places, spins = (tuple(each[i] for i in order) for each in (rotors.position_B, rotors.spin))
    turned = replace(vehicle, rotors=replace(rotors, position_B=places, spin=spins))
    assert map_outputs(turned) == (3, 2, 1, 0)


def test_rotors_that_spin_the_other_way_are_refused_by_name() -> None:
    vehicle = load_vehicle("paper")
    other = replace(vehicle, rotors=replace(vehicle.rotors, spin=(-1, -1, 1, 1)))
    with pytest.raises(ConfigError, match=r"rotors\.0 .* spin -1 is none of ArduPilot's"):
        map_outputs(other)
