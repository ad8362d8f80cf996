"""Two hundred scenario files that are wrong, each in its own way: a clear line for each, never a traceback."""

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.errors import ConfigError

Document = dict[str, Any]


def sound() -> Document:
    """Return a scenario with a table of many kinds, as TOML gives it."""
    window: Document = {"start_s": 0.5, "stop_s": 3.0}
    vector = [1.0, 0.0, -0.5]
    return {
        "name": "sound",
        "description": "a bit of everything",
        "duration_s": 5.0,
        "translation": "held",
        "altitude_m": 10.0,
        "control_rate_hz": 250,
        "physics_rate_hz": 1000,
        "delay_samples": 1,
        "wind": [
            {"kind": "constant", "velocity_mps": vector},
            {"kind": "step", "amplitude_mps": vector, "frame": "ned", **window},
            {"kind": "ramp", "speed_mps": 3.0, "from_deg": 270.0, "rise_s": 1.0},
            {"kind": "one_minus_cosine", "amplitude_mps": vector, "length_s": 1.0, **window},
            {"kind": "sine", "amplitude_mps": vector, "rate_rad_s": 2.0, "phase_rad": 0.1},
            {"kind": "sine_sweep", "amplitude_mps": vector, "rate_from_rad_s": 1.0, "rate_to_rad_s": 9.0, **window},
            {"kind": "shear", "wind_speed_20ft_mps": 5.0, "from_deg": 10.0, "roughness_m": 0.1},
            {"kind": "dryden", "intensity": "light", "airspeed_mps": 8.0, "specification": "MIL-HDBK-1797"},
            {"kind": "replay", "rows": [[0.0, *vector], [1.0, *vector]], "frame": "body"},
        ],
        "moment": [
            {"kind": "square", "amplitude_nm": vector, "rate_rad_s": 2.0, "frame": "body"},
            {"kind": "replay", "rows": [[0.0, *vector], [1.0, *vector]]},
        ],
        "gyro": {"bias_rad_s": vector, "noise": True},
        "event": [
            {"kind": "attitude", "at_s": 1.0, "euler_deg": vector},
            {"kind": "gyro_bias", "at_s": 1.0, "bias_rad_s": vector, "over_s": 0.5},
            {"kind": "gyro_noise", "at_s": 1.0, "factor": 2.0},
            {"kind": "gyro_range", "at_s": 1.0, "range_rad_s": 2.0},
            {"kind": "actuator_effect", "at_s": 1.0, "share": [0.5, 1.0, 0.0]},
            {"kind": "actuator_lag", "at_s": 1.0, "lag_s": 0.1},
            {"kind": "actuator_limit", "at_s": 1.0, "torque_limit_nm": [1.0, 1.0, 1.0]},
            {"kind": "payload", "at_s": 1.0, "mass_kg": -1.0, "inertia_kgm2": [0.0, 0.0, 0.0]},
            {"kind": "controller_hung", "at_s": 1.0, "for_s": 0.5},
        ],
        "link": [{"direction": "to_vehicle", "kind": "delay", "delay_s": 0.01}],
    }


def toml(value: Any) -> str:
    """Return a value as TOML, tables inline; a `Raw` stands as it is."""
    if isinstance(value, Raw):
        return value
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


class Raw(str):
    """TOML that is not made from a value."""

    __slots__ = ()


def written(document: Document) -> bytes:
    return "\n".join(f"{json.dumps(key)} = {toml(value)}" for key, value in document.items()).encode()


def anywhere(document: Document, draw: random.Random) -> Document:
    """Return the document or one of the tables in it."""
    tables = [document, document["gyro"]]
    tables += [table for key in ("wind", "moment", "event", "link") for table in document[key]]
    return draw.choice(tables)


OF_NO_USE = ["", "soon", "NaN", -1.0, -1e308, [], [1.0], ["a", "b", "c"], [0.0] * 4, {}, {"a": {}}, [[]], [[1, 2, 3]]]
NEVER = [Raw(text) for text in ("nan", "-inf", "1979-05-27", "07:32:00", "-0x1", "'''\n\n'''", "-9223372036854775809")]
WITH_ANY_NUMBER = {"from_deg", "phase_rad", "mass_kg"}


def spoil_a_value(document: Document, draw: random.Random) -> bytes:
    # A text may be any text and numbers of these keys are free; all else must be refused.
    table = anywhere(document, draw)
    key = draw.choice([key for key in table if key not in {"name", "description", *WITH_ANY_NUMBER}])
    wrong = draw.choice(OF_NO_USE + NEVER)
    if key in {"event", "wind", "moment", "link"} and wrong == []:
        wrong = 3
    table[key] = wrong
    return written(document)


def spoil_a_component(document: Document, draw: random.Random) -> bytes:
    vectors = [
        value
        for key in ("wind", "moment", "event")
        for table in document[key]
        for value in table.values()
        if isinstance(value, list) and not isinstance(value[0], list)
    ]
    draw.choice(vectors)[draw.randrange(3)] = draw.choice(["x", None, [], {}, Raw("inf"), Raw("nan")]) or Raw('""')
    return written(document)


def add_a_key(document: Document, draw: random.Random) -> bytes:
    key = draw.choice(["durations_s", "velocity", "Kind", "__class__", "self", "", "a\nb", "\u202e", "é" * 500, "0"])
    anywhere(document, draw)[key] = draw.choice([1, "x", [], {}])
    return written(document)


def leave_out_a_key(document: Document, draw: random.Random) -> bytes:
    must = {"description", "duration_s", "kind", "at_s", "rise_s", "length_s", "rate_rad_s", "rows", "direction"}
    table = anywhere(document, draw)
    while not (known := sorted(must & set(table))):
        table = anywhere(document, draw)
    del table[draw.choice(known)]
    return written(document)


def contradict(document: Document, draw: random.Random) -> bytes:
    wind, event = document["wind"], document["event"]
    changes: list[Callable[[], object]] = [
        lambda: wind.append({"kind": "dryden", "intensity": "severe"}),
        lambda: wind.append(wind[6]),
        lambda: wind[7].update(wind_speed_20ft_mps=5.0),
        lambda: wind[0].update(speed_mps=5.0),
        lambda: wind[2].update(frame="body"),
        lambda: wind[1].update(start_s=4.0),
        lambda: wind[4].update(phase_rad=1e9),
        lambda: wind[8].update(rows=[[1.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0]]),
        lambda: event.append({**event[1], "at_s": 1.2}),
        lambda: event[5].update(lag_s=1e-9),
        lambda: document.update(duration_s=1e-9),
        lambda: document.update(duration_s=1e300),
        lambda: document.update(control_rate_hz=2001, physics_rate_hz=2001),
        lambda: document.update(physics_rate_hz=999),
        lambda: document.update(translation="free", control_rate_hz=100, physics_rate_hz=100),
    ]
    draw.choice(changes)()
    return written(document)


def break_the_text(document: Document, draw: random.Random) -> bytes:
    text = written(document)
    at = draw.randrange(1, len(text) - 2)
    return draw.choice(
        [
            text[:at] + b"\x00" + text[at:],
            text[:at] + b"\xff\xfe" + text[at:],
            text[: text.rindex(b"]")],
            b"\xef\xbb\xbf" + text,
            text + b"\nduration_s = 1\n",
            text + b"\nx = " + b"[" * 5000 + b"]" * 5000,
            text + b"\nx = " + b"9" * 5000,
            text + b"\n" + b"a." * 5000 + b"b = 1",
            bytes(draw.randrange(256) for _ in range(200)),
            b"\x1f\x8b" + text,
            json.dumps(document).encode(),
            b"[[wind]]\n" * 100,
            b"",
        ]
    )


def name_a_bad_file(document: Document, draw: random.Random) -> bytes:
    names = ["none.csv", "", ".", "/", "\x00", "a\nb", "../" * 3000, "hostile.toml", "é.csv", "x" * 5000, 7, ["a"]]
    document["wind"][8] = {"kind": "replay", "file": draw.choice(names)}
    return written(document)


WAYS = [
    spoil_a_value,
    spoil_a_component,
    add_a_key,
    leave_out_a_key,
    contradict,
    break_the_text,
    name_a_bad_file,
]


def test_the_file_that_is_spoilt_is_sound(tmp_path: Path) -> None:
    path = tmp_path / "sound.toml"
    path.write_bytes(written(sound()))
    assert load_scenario(path) == validate(Scenario, sound(), "sound")


@pytest.mark.parametrize("number", range(200))
def test_a_hostile_file_is_refused_in_one_clear_line(number: int, tmp_path: Path) -> None:
    path = tmp_path / "hostile.toml"
    path.write_bytes(WAYS[number % len(WAYS)](sound(), random.Random(number)))
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert message.isprintable()
    assert 3 < len(message) - len(str(path)) < 3000


@pytest.mark.parametrize("key", ["from_s", "to_s"])
def test_a_time_beyond_a_day_is_refused(key: str) -> None:
    require = {"metric": "peak_deg", "at_most": 1.0, key: 1e308}
    with pytest.raises(ConfigError, match=rf"require\.0\.{key}: .* 86400"):
        validate(Scenario, {**sound(), "require": [require]}, "far")


def test_what_is_wrong_is_told_in_words_of_toml(tmp_path: Path) -> None:
    path = tmp_path / "odd.toml"
    path.write_text('description = "odd"\nduration_s = 1.0\nwind = 3\ngyro = 4\nlink = [5]\n')
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert str(caught.value).removeprefix(f"{path}: ").split("; ") == [
        "line 3, wind: input should be a valid list (given 3)",
        "line 4, gyro: input should be a table (given 4)",
        "line 5, link.0: input should be a table (given 5)",
    ]
