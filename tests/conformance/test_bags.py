"""Bags read back by readers that share no code with the writer."""

import json
import random
import shutil
import subprocess
import sys

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pydantic_core import to_jsonable_python
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from firmware_model.config.scenario import load_scenario
from firmware_model.errors import ConfigError
from firmware_model.numerics.rotations import euler_angles
from firmware_model.recording.estimates import ESTIMATE
from firmware_model.recording.journal import RECORD, record_blocks, record_type
from gustproof.flight.recording.bag import read_bag, write_bag
from gustproof.flight.recording.definitions import STANDARD_MESSAGES, TYPES, definition
from gustproof.flight.recording.topics import ANGLE_TOPICS, TOPICS, encode

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
    named = {topic.name for topic in (*TOPICS, *ANGLE_TOPICS)}
    assert set(found) == {"/flight", "/mode", "/tf", "/tf_static", *named}
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


def test_transforms_place_the_body_in_ned_and_join_it_to_enu_and_flu(bag):
    """Five samples of 4 ms lie between two poses; the axes of ROS are written out, parent from child."""
    records, found = flight(rates=True), by_topic(bag)
    moving = [message.transforms[0] for _, message in found["/tf"]]
    assert len(moving) == -(-N // 5)
    for each, record in zip(moving, records[::5], strict=True):
        assert (each.header.frame_id, each.child_frame_id) == ("map_ned", "base_link_frd")
        assert xyz(each.transform.translation) == record["position_N"].tolist()
        assert [each.transform.rotation.w, *xyz(each.transform.rotation)] == record["q_NB"].tolist()
        stamp = each.header.stamp
        assert stamp.sec * 10**6 + stamp.nanosec // 1000 == record["time_us"]
    ((_, static),) = found["/tf_static"]
    turns = {(each.header.frame_id, each.child_frame_id): each.transform.rotation for each in static.transforms}
    axes = {pair: Rotation.from_quat([*xyz(turn), turn.w]).as_matrix() for pair, turn in turns.items()}
    assert axes.keys() == {("map", "map_ned"), ("base_link_frd", "base_link")}
    assert axes["map", "map_ned"] == pytest.approx(np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]))
    assert axes["base_link_frd", "base_link"] == pytest.approx(np.diag([1, -1, -1]))


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
        assert reader.message_count == N * (len(TOPICS) + len(ANGLE_TOPICS)) + 3 + 1 + -(-N // 5)


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


STEPS = load_scenario("attitude-steps")
LONG = {
    "modes": lambda records: records["mode"].__setitem__(slice(1000, 1003), (7, 7, 8)),
    "no rates": lambda records: records["omega_command_B"].fill(np.nan),
    "rates at last": lambda records: records["omega_command_B"].__setitem__(slice(0, -1), np.nan),
    "no number": lambda records: records["q_NB"].__setitem__(slice(1500, None), np.nan),
}


@pytest.mark.parametrize("spoil", LONG.values(), ids=LONG)
@pytest.mark.parametrize("size", [13, 1000, 1001])
def test_a_bag_of_many_blocks_is_that_of_one(tmp_path, monkeypatch, spoil, size):
    records, estimates = (
        flight(2000, rates=True),
        np.random.default_rng(3).standard_normal(100 * ESTIMATE.itemsize // 8).view(ESTIMATE),
    )
    records["time_us"], estimates["time_us"] = np.arange(2000) * 4000.0, np.arange(100) * 20_000.0
    yaw = np.cumsum(np.random.default_rng(4).uniform(-1.0, 2.0, len(records)))  # many turns, some of them back
    records["q_NB"] = np.column_stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)])
    spoil(records)
    about = {"scenario": to_jsonable_python(STEPS)}
    for place, block in (("one", len(records)), ("many", size)):
        monkeypatch.setattr(record_blocks, "__defaults__", (block,))
        write_bag(tmp_path / place / "flight", records, about, estimates)
    one, many = (sorted((tmp_path / place / "flight").iterdir()) for place in ("one", "many"))
    assert [path.read_bytes() for path in many] == [path.read_bytes() for path in one]


def test_the_yaw_of_a_bag_of_many_blocks_is_unwrapped_as_one(tmp_path, monkeypatch):
    records = flight()
    yaw = np.arange(N) * 2.5 - 3.0
    records["q_NB"] = np.column_stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)])
    monkeypatch.setattr(record_blocks, "__defaults__", (7,))
    write_bag(tmp_path / "flight", records, FLIGHT)
    told = [
        [message.roll, message.pitch, message.yaw] for _, message in by_topic(tmp_path / "flight")["/attitude/euler"]
    ]
    assert told == np.degrees(euler_angles(records["q_NB"])).tolist()
    assert told[-1][2] == pytest.approx(np.degrees(yaw[-1]))


HOURLY = """
import resource, sys
from pathlib import Path
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording.journal import read_journal
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.scoring.metrics import measure
from gustproof.flight.scoring.requirements import judge
from gustproof.flight.routes.outcome import infer_outcome
from gustproof.flight.routes.upsets import describe_upsets

def peak_mib():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

scenario, vehicle = load_scenario("gust-roll"), load_vehicle("paper")
_, records = read_journal(Path(sys.argv[1]), sound=True)
measure(records[:9], vehicle, scenario), judge(records[:9], scenario, vehicle)
before = peak_mib()
measure(records, vehicle, scenario), judge(records, scenario, vehicle)
infer_outcome(records, scenario), describe_upsets(records, scenario, vehicle)
write_bag(Path(sys.argv[2]), records, {})
print(len(records), peak_mib() - before)
"""


def test_a_bag_of_a_long_flight_takes_little_memory(tmp_path):
    count, block = 160_000, np.zeros(10_000, RECORD)  # 73 MiB; as one array it took 380 MiB more
    block["q_NB"][:, 0], block["mode"] = 1.0, 6
    with (tmp_path / "journal").open("wb") as file:
        file.write(b"{}\n")
        for begin in range(0, count, len(block)):
            block["time_us"] = (begin + np.arange(len(block))) * 4000.0
            file.write(block.tobytes())
    command = [sys.executable, "-c", HOURLY, str(tmp_path / "journal"), str(tmp_path / "bag")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    samples, more_mib = map(float, done.stdout.split())
    assert samples == count
    assert more_mib < 100.0


def test_a_bag_is_never_overwritten(tmp_path):
    write_bag(tmp_path / "flight", flight(), FLIGHT)
    with pytest.raises(ConfigError, match="never overwritten"):
        write_bag(tmp_path / "flight", flight(), FLIGHT)


def test_an_interrupted_write_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("gustproof.flight.recording.bag.encode", interrupt)
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
