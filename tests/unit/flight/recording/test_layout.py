"""Each path in a shipped layout is a number or a topic of a bag that another library reads."""

import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from gustproof.flight.recording.layout import read_layout


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Return the first message on each topic of a bag with events and requirements, and the topics."""
    from dataclasses import replace

    from firmware_model.config.requirement import Requirement
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.vehicle import load_vehicle
    from firmware_model.recording.journal import record_type
    from gustproof.flight.recording.bag import write_bag
    from gustproof.flight.routes.flight import FlightPlan
    from gustproof.flight.scoring.requirements import RequirementResult
    from gustproof.law.form import load_law

    require = (Requirement(metric="peak_deg", axis="roll", at_most=1.0),)
    scenario = replace(load_scenario("attitude-steps"), duration_s=4.0, require=require)
    records = np.zeros(1000, dtype=record_type(4))
    records["time_us"] = np.arange(1000) * 4000
    records["q_NB"] = np.cos(0.05), np.sin(0.05), 0.0, 0.0
    plan = FlightPlan(scenario, load_law("pid-fair"), load_vehicle("paper"), 1, False)
    told = RequirementResult(requirement=require[0], value=5.7, judged=True).to_dict()
    bag = tmp_path_factory.mktemp("bags") / "flight"
    write_bag(bag, records, plan.metadata(), None, [told])
    found = {}
    with AnyReader([bag]) as reader:
        for connection, time_ns, payload in reader.messages():
            found.setdefault(connection.topic, []).append((time_ns, reader.deserialize(payload, connection.msgtype)))
    return found


def value_at(messages, path):
    """Return the number at a path of PlotJuggler's, `/topic/field/field`."""
    topic = max((topic for topic in messages if path.startswith(f"{topic}/")), key=len)
    value = messages[topic][0][1]
    for name in path.removeprefix(f"{topic}/").split("/"):
        value = getattr(value, name)
    return value


@pytest.mark.slow
def test_every_curve_of_plotjuggler_is_a_number_in_the_bag(messages):
    root = ElementTree.fromstring(read_layout(".xml"))
    paths = [curve.get("name") for curve in root.iter("curve")]
    assert len(paths) == 18
    assert all(isinstance(value_at(messages, path), float) for path in paths)
    for splitter in root.iter("DockSplitter"):
        assert len(splitter) == int(splitter.get("count")) == len(splitter.get("sizes").split(";"))


def test_every_path_of_foxglove_is_in_the_bag_and_every_panel_in_the_layout(messages):
    layout = json.loads(read_layout(".json"))
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) == 18
    assert all(isinstance(value_at(messages, path.replace(".", "/")), float) for path in paths)
    assert {panels["RosOut!events"]["topicToRender"], panels["RawMessages!requirements"]["topicPath"]} <= set(messages)
    placed = re.findall(r'"((?:3D|Plot|RosOut|RawMessages)![^"]+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(panels)
    moving, still = (messages[topic][0][1].transforms for topic in ("/tf", "/tf_static"))
    frames = {frame for each in (*moving, *still) for frame in (each.header.frame_id, each.child_frame_id)}
    view = panels["3D!vehicle"]
    hidden = {name.removeprefix("frame:") for name in view["transforms"]}
    assert frames == {view["followTf"], view["layers"]["grid"]["frameId"], *hidden}


def test_angles_are_degrees_and_the_error_is_to_the_reference(messages):
    """The attitude is 0.1 rad of roll; from 2 s on the reference is 10 deg."""
    euler, reference, error = (
        [(time_ns, message.roll) for time_ns, message in messages[f"/attitude/{name}"]]
        for name in ("euler", "reference", "error")
    )
    assert euler[0][1] == pytest.approx(np.degrees(0.1))
    assert [angle for time_ns, angle in reference if time_ns < 2_000_000_000] == [0.0] * 500
    assert [angle for time_ns, angle in reference if time_ns >= 2_000_000_000] == pytest.approx([10.0] * 500)
    assert error[-1][1] == pytest.approx(np.degrees(0.1) - 10.0)
    assert len(euler) == len(error) == 1000


def test_events_and_requirements_stand_at_their_times(messages):
    assert [(time_ns, message.msg) for time_ns, message in messages["/events"]] == [
        (2_000_000_000, "reference 10, 0, 0 deg")
    ]
    ((time_ns, message),) = messages["/requirements"]
    assert time_ns == 3_996_000_000  # the last sample
    assert (message.metric, message.axis, message.value, message.at_most) == ("peak_deg", "roll", 5.7, 1.0)
    assert np.isnan(message.at_least)
    assert (message.judged, message.held) == (True, False)
