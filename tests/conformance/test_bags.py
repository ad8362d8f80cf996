"""Bags read back by readers that share no code with the writer."""

import json
import random
import shutil

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from firmware_model.errors import ConfigError
from firmware_model.recording.journal import RECORD, record_type
from gustproof.recording.bag import read_bag, write_bag
from gustproof.recording.definitions import STANDARD_MESSAGES, TYPES, definition
from gustproof.recording.topics import ANGLE_TOPICS, TOPICS, encode

FLIGHT = {"scenario": "paper", "law": "hinf-d1", "seed": 1}
N = 50


def flight(n: int = N, rates: bool = False):
    """A journal in which every number differs from every other, so that no two can be mistaken."""
    records = np.random.default_rng(2).standard_normal(n * RECORD.itemsize // 8).view(RECORD)
    records["time_us"] = 1_999_996_000 + np.arange(n) * 4000.0  # seconds turn over inside the flight
    records["mode"] = np.where(np.arange(n) < 20, 6, 7)
    if not rates:
        records["omega_command_B"] = np.nan
    return records


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "flight"
    write_bag(path, flight(rates=True), FLIGHT)
    return path


def by_topic(bag):
    with (bag / f"{bag.name}.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        messages: dict[str, list] = {}
        for _, channel, message, decoded in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append((message.log_time, decoded))
    return messages


def xyz(vector) -> list[float]:
    return [vector.x, vector.y, vector.z]


def test_mcap_and_its_ros2_decoder_find_every_number_under_its_ros_name(bag):
    records, found = flight(rates=True), by_topic(bag)
    assert set(found) == {"/flight", "/mode", *(topic.name for topic in (*TOPICS, *ANGLE_TOPICS))}
    for i in range(N):
        one = {topic: messages[i][1] for topic, messages in found.items() if len(messages) == N}
        expected = {
            "gyro_B": xyz(one["/imu"].angular_velocity),
            "specific_force_B": xyz(one["/imu"].linear_acceleration),
            "torque_command_B": xyz(one["/command/torque"].wrench.torque),
            "omega_command_B": xyz(one["/command/rates"].twist.angular),
            "torque_B": xyz(one["/actuator/torque"].wrench.torque),
            "position_N": xyz(one["/truth/pose"].pose.position),
            "q_NB": [one["/truth/pose"].pose.orientation.w, *xyz(one["/truth/pose"].pose.orientation)],
            "velocity_N": xyz(one["/truth/velocity"].vector),
            "omega_B": xyz(one["/truth/rates"].vector),
            "gust_B": xyz(one["/gust"].twist.linear),
            "gust_omega_B": xyz(one["/gust"].twist.angular),
            "command_age": [one["/command/age"].age],
            "moment_B": xyz(one["/moment"].wrench.torque),
            "thrust_z_command": [one["/command/torque"].wrench.force.z],
            "thrust_z": [one["/actuator/torque"].wrench.force.z],
            "rotors": list(one["/actuator/rotors"].thrust),
            "wind_N": xyz(one["/wind"].vector),
        }
        assert set(expected) == set(RECORD.names or ()) - {"time_us", "mode"}
        for field, values in expected.items():
            assert values == records[field][i].tolist(), field


def test_the_thrusts_of_eight_rotors_are_read_back_by_us_and_others(tmp_path):
    numbers = np.random.default_rng(3).standard_normal((N, record_type(8).itemsize // 8))
    records = numbers.view(record_type(8))[:, 0]
    records["time_us"], records["mode"], records["unused"] = np.arange(N) * 4000.0, 6, np.nan
    write_bag(tmp_path / "flight", records, FLIGHT)
    assert read_bag(tmp_path / "flight")[1].tobytes() == records.tobytes()
    told = [list(message.thrust) for _, message in by_topic(tmp_path / "flight")["/actuator/rotors"]]
    assert told == records["rotors"].tolist()


def test_stamps_are_model_time_and_frames_say_ned_and_frd(bag):
    records, found = flight(), by_topic(bag)
    frames = dict.fromkeys(("/truth/pose", "/truth/velocity", "/wind"), "map_ned")
    for topic in TOPICS:
        for (log_time, message), time_us in zip(found[topic.name], records["time_us"], strict=True):
            stamp = message.header.stamp
            assert log_time == time_us * 1000 == stamp.sec * 10**9 + stamp.nanosec
            assert message.header.frame_id == frames.get(topic.name, "base_link_frd")


def test_an_unknown_attitude_is_marked_as_the_imu_message_asks(bag):
    assert all(message.orientation_covariance[0] == -1.0 for _, message in by_topic(bag)["/imu"])


def test_the_definitions_of_our_own_messages_say_units_and_frames(bag):
    with (bag / f"{bag.name}.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    schemas = {schema.name: schema.data.decode() for schema in summary.schemas.values()}
    own = {name: text for name, text in schemas.items() if name.startswith("gustproof_msgs/")}
    assert set(own) == {f"gustproof_msgs/msg/{name}" for name in ("Angles", "CommandAge", "Flight", "Mode", "Rotors")}
    age, mode, rotors, flown = (
        own[f"gustproof_msgs/msg/{name}"] for name in ("CommandAge", "Mode", "Rotors", "Flight")
    )
    assert "# [N] thrust against the z axis, up: front right, rear left, front left, rear right." in rotors
    assert "# [samples] whole, from the sample of the command's timestamp to this one" in age
    for text in (age, rotors, mode):
        assert "frame_id: the body, forward-right-down" in text
    assert "_N is north-east-down, _B is forward-right-down" in flown
    assert "uint32 OFFBOARD=393216\n" in mode


def test_the_definitions_of_standard_messages_are_those_of_ros_2_jazzy():
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    for name in STANDARD_MESSAGES:
        assert definition(name) == (jazzy.generate_msgdef(name, ros_version=2)[0], jazzy.hash_rihs01(name))


def test_the_flight_topic_names_the_flight_and_the_mode_is_written_when_it_changes(bag):
    found = by_topic(bag)
    assert [json.loads(message.document) for _, message in found["/flight"]] == [FLIGHT]
    assert [(time // 1000, message.custom_mode) for time, message in found["/mode"]] == [
        (1_999_996_000, 6),
        (1_999_996_000 + 20 * 4000, 7),
    ]
    for time, message in found["/mode"]:
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time


def test_rosbags_own_reader_accepts_the_folder_and_its_metadata(bag):
    with AnyReader([bag]) as reader:
        assert {connection.topic for connection in reader.connections} >= {"/imu", "/flight"}
        assert reader.message_count == N * (len(TOPICS) + len(ANGLE_TOPICS)) + 3


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_the_bytes_are_those_of_a_general_cdr_serialiser(topic):
    for payload in encode(topic, flight(rates=True)):
        value = TYPES.deserialize_cdr(payload.tobytes(), topic.message)
        assert bytes(TYPES.serialize_cdr(value, topic.message)) == payload.tobytes()


@pytest.mark.parametrize("rates", [True, False])
def test_a_bag_gives_its_records_back_to_the_bit(tmp_path, rates):
    write_bag(tmp_path / "flight", flight(rates=rates), FLIGHT)
    header, records = read_bag(tmp_path / "flight")
    assert header == FLIGHT
    assert records.tobytes() == flight(rates=rates).tobytes()
    assert ("/command/rates" in by_topic(tmp_path / "flight")) == rates


def test_equal_records_give_equal_files(tmp_path):
    for place in ("a", "b"):
        write_bag(tmp_path / place / "flight", flight(), FLIGHT)
    first, second = (tmp_path / place / "flight" / "flight.mcap" for place in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


def test_a_bag_is_never_overwritten(tmp_path):
    write_bag(tmp_path / "flight", flight(), FLIGHT)
    with pytest.raises(ConfigError, match="never overwritten"):
        write_bag(tmp_path / "flight", flight(), FLIGHT)


def test_an_interrupted_write_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("gustproof.recording.bag.encode", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_bag(tmp_path / "flight", flight(), FLIGHT)
    assert list(tmp_path.iterdir()) == []


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("damage", range(40))
def test_a_damaged_bag_is_read_or_refused_in_one_line(bag, tmp_path, damage):
    draw = random.Random(damage)
    shutil.copytree(bag, tmp_path / "flight")
    victim = tmp_path / "flight" / draw.choice(("metadata.yaml", "flight.mcap"))
    content = bytearray(victim.read_bytes())
    for _ in range(draw.choice((1, 20))):
        content[draw.randrange(len(content))] = draw.randrange(256)
    victim.write_bytes(content[: draw.choice((len(content), draw.randrange(len(content))))])
    told = ""
    try:
        read_bag(tmp_path / "flight")
    except ConfigError as error:
        told = str(error)
    assert not told or told.startswith(f"{tmp_path / 'flight'}: ")
    assert told.isprintable()


@pytest.mark.parametrize("spoil", ["no such folder", "another program's bag"])
def test_what_is_not_a_bag_of_ours_is_refused_in_one_line(tmp_path, spoil):
    path = tmp_path / "flight"
    if spoil == "another program's bag":
        from rosbags.rosbag2 import StoragePlugin, Writer

        types = get_typestore(Stores.ROS2_JAZZY)
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topic = writer.add_connection("/chatter", "std_msgs/msg/Int32", typestore=types)
            writer.write(topic, 0, types.serialize_cdr(types.types["std_msgs/msg/Int32"](1), "std_msgs/msg/Int32"))
    with pytest.raises(ConfigError) as error:
        read_bag(path)
    assert "\n" not in str(error.value)
