"""Reference pages as Markdown, made from what the program itself uses: models, message tables, docstrings."""

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import gustproof
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording import journal
from firmware_model.session.vehicle_endpoint import HEARTBEAT_US, VehicleEndpoint
from gustproof.flight.recording.definitions import (
    ANGLES,
    COMMAND_AGE,
    FLIGHT,
    LOG,
    MODE,
    REQUIREMENT,
    TF_MESSAGE,
    definition,
    rotors_message,
)
from gustproof.flight.recording.derived import EVENTS_TOPIC, REQUIREMENTS_TOPIC
from gustproof.flight.recording.topics import (
    ANGLE_TOPICS,
    BASE_LINK_FRD,
    ESTIMATE_TOPICS,
    MAP_NED,
    TOLD_WIND_TOPIC,
    TOPICS,
)
from gustproof.flight.recording.transforms import TF_S, TF_STATIC_TOPIC, TF_TOPIC
from gustproof.guide.schemas import Schema, attribute_docs, describe_keys, describe_values, file_schema
from gustproof.law.form import FORMAT, Law, Provenance, RateLimit, Schedule

_EDITORS = (
    "`gustproof guide --schemas DIR` writes these tables as JSON Schemas. An editor that knows TOML, such as VS Code "
    "with Even Better TOML, completes and checks keys by them. Begin the file with "
    "`#:schema ./DIR/{kind}.schema.json`, the path from the file itself.\n\n"
    "Rules between keys are checked when the file is read; each mistake is one line."
)


def scenario_keys() -> str:
    """Return the reference of scenario files."""
    return _keys_page("scenario", "Keys of a scenario file")


def vehicle_keys() -> str:
    """Return the reference of vehicle files."""
    return _keys_page("vehicle", "Keys of a vehicle file")


def design_keys() -> str:
    """Return the reference of design files, and of the files of an autopilot's rate loops."""
    loops = _keys_page("loops", "Keys of a file of rate loops").replace("# Keys", "## Keys", 1)
    return f"{_keys_page('design', 'Keys of a design file')}\n{loops}"


def law_keys() -> str:
    """Return the reference of law files."""
    parts = [
        f"# Keys of a law file\n\nA law file is JSON. Its key `format` is `{FORMAT}`. Matrices are lists of rows. A "
        "law flies by one formula:\n\n```text\n"
        + inspect.cleandoc(import_module(Law.__module__).__doc__ or "").split("\n\n")[1]
        + "\n```\n\n`y` is gyro p, q, r [rad/s] and reference phi, theta, psi [rad]. With an accelerometer, roll and "
        "pitch by gravity [rad] follow. `rate_limit` and `schedule` may be left out.\n"
    ]
    for title, kind in (
        ("The law", Law),
        ("rate_limit", RateLimit),
        ("schedule", Schedule),
        ("provenance", Provenance),
    ):
        parts.append(f"## {title}\n\n{_attributes_table(kind, 'key')}")
    return "\n".join(parts)


def _keys_page(kind: str, title: str) -> str:
    schema = file_schema(kind)
    parts = [f"# {title}\n\n{schema['description']}\n\n{_EDITORS.format(kind=kind)}\n\n{_keys_table(schema)}"]
    shown = {name: table for name, table in schema.get("$defs", {}).items() if "properties" in table}
    for name, table in shown.items():
        parts.append(f"## {name}\n\n{table['description']}\n\n{_keys_table(table)}")
    for name, table in schema.get("$defs", {}).items():
        if "enum" in table:
            parts.append(f"## {name}\n\n{_plain(table.get('description', ''))}\n\n{_bullets(table['enum'])}")
        elif "anyOf" in table:
            parts.append(f"## {name}\n\nEither {describe_values(table)}.\n")
    page = "\n".join(parts)
    names = "|".join(map(re.escape, schema.get("$defs", {})))
    return re.sub(rf"\[({names})\]", lambda m: f"[{m[1]}](#{m[1].lower()})", page) if names else page


def _bullets(values: Iterable[Any]) -> str:
    return "".join(f"- `{value}`\n" for value in values)


def _keys_table(table: Schema) -> str:
    rows = [(f"`{key.name}`", key.values, key.default or "must be given", key.meaning) for key in describe_keys(table)]
    return markdown_table(("key", "values", "default", "meaning"), rows)


def _attributes_table(kind: type, heading: str) -> str:
    names = [field.name for field in fields(kind)] if is_dataclass(kind) else list(getattr(kind, "_fields", ()))
    docs = attribute_docs(kind)
    return markdown_table((heading, "meaning"), [(f"`{name}`", docs.get(name, "")) for name in names])


def bag_topics() -> str:
    """Return the reference of a recording: its topics, message types of our own, and the journal's fields."""
    meanings = dict(re.findall(r'\("(\w+)", "<f8"[^#\n]*# (.+)', inspect.getsource(journal))) | _DERIVED
    rows = [(f"`{name}`", f"`{kind}`", "", meaning) for name, kind, meaning in _TOLD_TOPICS]
    rows += [
        (
            f"`{topic.name}`",
            f"`{topic.message}`",
            f"`{topic.frame_id}`",
            "; ".join(f"`{name}`: {meanings.get(name, 'told by a real autopilot')}" for name in topic.fields),
        )
        for topic in (*TOPICS, *ANGLE_TOPICS, *ESTIMATE_TOPICS, TOLD_WIND_TOPIC)
    ]
    own = (FLIGHT, MODE, rotors_message(4), COMMAND_AGE, ANGLES, REQUIREMENT)
    texts = {name: definition(name)[0].partition("=" * 80)[0] for name in own}
    return "\n".join(
        [
            "# Topics of a recording\n\nA flight is recorded as a rosbag2 folder with one MCAP file. ROS 2 tools, "
            "[Foxglove and PlotJuggler](viewers.md) open it. It is equal to the flight's journal bit for bit. N is "
            "north, east, down; B is forward, right, down. The type of `/actuator/rotors` has the number of rotors "
            "in its name if these are not four.\n",
            markdown_table(("topic", "type", "frame", "content"), rows),
            *(f"## {name}\n\n```text\n{text.strip()}\n```\n" for name, text in texts.items()),
        ]
    )


_DERIVED = {
    "euler": "[deg] Euler angles of the true attitude",
    "reference": "[deg] angles that the scenario wants",
    "error": "[deg] attitude less reference, as figures and requirements count it",
}
"""Meaning of the fields that are made for viewers."""
_TOLD_TOPICS = (
    ("/flight", FLIGHT, "everything that a repetition needs, once"),
    ("/mode", MODE, "mode of the autopilot, at each change"),
    (EVENTS_TOPIC, LOG, "a line as each gust, fault and event begins and ends"),
    (REQUIREMENTS_TOPIC, REQUIREMENT, "result of each requirement, at the end of its window"),
    (TF_TOPIC, TF_MESSAGE, f"true pose of `{BASE_LINK_FRD}` in `{MAP_NED}`, each {1e3 * TF_S:.0f} ms"),
    (TF_STATIC_TOPIC, TF_MESSAGE, "`map` is east, north, up; `base_link` is forward, left, up"),
)
"""Topics without a stream of numbers: name, type and content."""


def mavlink_messages() -> str:
    """Return the reference of the vehicle's MAVLink: streams, messages that it reads, and commands."""
    from pymavlink.dialects.v20 import all as wire

    intervals = {wire.MAVLINK_MSG_ID_HEARTBEAT: HEARTBEAT_US}  # on a clock of its own
    endpoint = VehicleEndpoint(load_vehicle("paper"), load_scenario("calm"), 1, lambda _: None, lockstep=True)
    services, known = endpoint.services, wire.mavlink_map
    sent = [
        (
            f"`{known[number].msgname}`",
            str(number),
            _interval(intervals.get(number, stream.interval_us)),
            _message_fields(known[number]),
        )
        for number, stream in sorted(services.streams.items())
    ]
    sent += [
        (f"`{known[number].msgname}`", str(number), "on request", _message_fields(known[number]))
        for number in sorted(services.on_request)
    ]
    ids = {message.msgname: number for number, message in known.items()}
    answers = {ids[name] for name in _answers(type(services))} - {*services.streams, *services.on_request}
    sent += [
        (f"`{known[number].msgname}`", str(number), "as an answer", _message_fields(known[number]))
        for number in sorted(answers)
    ]
    setpoints = (wire.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET)
    read = [
        (f"`{known[number].msgname}`", str(number), _message_fields(known[number]))
        for number in sorted({*services.requests, *setpoints} & known.keys())
    ]
    commands = [
        (f"`{wire.enums['MAV_CMD'][number].name}`", str(number), wire.enums["MAV_CMD"][number].description)
        for number in sorted(services.commands)
    ]
    return "\n".join(
        [
            "# MAVLink messages\n\nThe vehicle of `gustproof autopilot` and `gustproof fly` speaks MAVLink 2. "
            "[The protocol page](protocol.md) tells what a controller sends when. Parameters are listed by "
            "`gustproof autopilot params`.\n",
            "## Messages that the vehicle sends\n",
            markdown_table(("message", "id", "interval by default", "fields"), sent),
            "## Messages that it reads\n",
            markdown_table(("message", "id", "fields"), read),
            "## Commands that it obeys or refuses with a reason\n",
            markdown_table(("command", "id", "meaning in MAVLink"), commands),
        ]
    )


def _answers(services: type) -> set[str]:
    """Return the names of the messages that the sources of the services build."""
    sources = (path.read_text(encoding="utf-8") for path in Path(inspect.getfile(services)).parent.glob("*.py"))
    return {name.upper() for text in sources for name in re.findall(r"MAVLink_(\w+)_message", text)}


def _interval(interval_us: int | None) -> str:
    return "on request" if interval_us is None else f"{interval_us / 1000:g} ms"


def _message_fields(message: Any) -> str:
    units = message.fieldunits_by_name
    return ", ".join(f"{name}{f' [{units[name]}]' if name in units else ''}" for name in message.fieldnames)


_TASKS = {
    "Synthesise": ("gustproof.robust", "gustproof.law.discretize", "gustproof.design.de"),
    "Prove": ("gustproof.prove", "gustproof.checker", "gustproof.studies.worst_case"),
    "Tune and judge": (
        "gustproof.design",
        "gustproof.studies.rate",
        "gustproof.airframe",
        "gustproof.logs",
        "gustproof.errors",
    ),
    "Fly": ("firmware_model", "gustproof"),
}
"""Tasks, and the rooms whose public names serve each; the first that fits counts."""


def python_api() -> str:
    """Return the reference of the public names of the package, from signatures and docstrings."""
    sources = gustproof.stub_names("gustproof")  # type: ignore[attr-defined]
    names = sorted(set(sources) - {"__version__"}, key=str.lower)
    parts = [
        "# Python API\n\nAll names are imported from `gustproof`. The examples are run by the tests. "
        "[The library page](library.md) shows a whole way through them.\n",
    ]
    for task in reversed(_TASKS):
        rows = [
            (f"[`{name}`](#{name.lower()})", _first_line(getattr(gustproof, name)))
            for name in names
            if task == next(each for each, rooms in _TASKS.items() if sources[name][0].startswith(rooms))
        ]
        parts.append(f"**{task}**\n\n{markdown_table(('name', 'purpose'), rows)}")
    for name in names:
        value = getattr(gustproof, name)
        parts.append(f"## {name}\n\n```python\n{_signature(name, value)}\n```\n\n{_docstring(value.__doc__ or '')}")
        if inspect.isclass(value) and (rows := list(_class_rows(value))):
            parts.append(markdown_table(("attribute", "meaning"), rows))
    return "\n".join(parts)


def _class_rows(kind: type) -> Iterator[tuple[str, str]]:
    for name, text in attribute_docs(kind).items():
        if not name.startswith("_"):
            yield f"`{name}`", text.partition("\n\n")[0]


def _first_line(value: Any) -> str:
    return _plain((value.__doc__ or "").strip().partition("\n\n")[0])


def _signature(name: str, value: Any) -> str:
    try:
        signature = inspect.signature(value)
    except ValueError:
        return name
    bare = [each.replace(annotation=inspect.Parameter.empty) for each in signature.parameters.values()]
    bare = [each.replace(default=_Shown(each.default)) if each.default is not each.empty else each for each in bare]
    return f"{name}{signature.replace(parameters=bare, return_annotation=inspect.Signature.empty)}"


class _Shown:
    """Default of a parameter as its signature shows it, without memory addresses."""

    def __init__(self, value: Any) -> None:
        self.text = getattr(value, "__name__", None) or re.sub(r" at 0x\w+", "", repr(value))

    def __repr__(self) -> str:
        """Return the text."""
        return self.text


def _docstring(text: str) -> str:
    """Return a numpy docstring as Markdown: sections as bold lines, examples as code."""
    parts = re.split(r"^(\w+)\n-{3,}$", inspect.cleandoc(text), flags=re.MULTILINE)
    shown = [parts[0].strip()]
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        if title == "Examples":
            shown.append(f"```python\n{body.strip()}\n```")
        else:
            entries = re.findall(r"^(\S.*)\n((?:[ ]+.*\n?|\n)*)", body.strip() + "\n", flags=re.MULTILINE)
            lines = [f"- `{name}`: {_plain(about)}" for name, about in entries]
            shown.append(f"**{title}**\n\n" + "\n".join(lines))
    return "\n\n".join(part for part in shown if part) + "\n"


def command_options(commands: Mapping[str, Any], context: Callable[[str, Any], Any]) -> str:
    """Return the reference of the command line from its click commands, by their full names.

    `context` makes the click context of a command by its name.
    """
    parts = [
        "# Options of every command\n\nThe same text as `--help` of each command. Exit statuses and the purpose of "
        "each are on [the page of commands](commands.md).\n"
    ]
    for name, command in commands.items():
        usage = command.get_usage(context(name, command)).removeprefix("Usage: ")
        rows = [_option_row(parameter) for parameter in command.params if not getattr(parameter, "hidden", False)]
        parts.append(f"## {name}\n\n```console\n{' '.join(usage.split())}\n```\n\n{_help_text(command.help or '')}\n")
        if rows:
            parts.append(markdown_table(("option", "default", "meaning"), rows))
    return "\n".join(parts)


def _option_row(parameter: Any) -> tuple[str, str, str]:
    names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    default = getattr(parameter.default, "value", parameter.default)
    shown = default is not None and not callable(default) and default not in (False, "", ())
    return names, f"`{default}`" if shown else "", getattr(parameter, "help", None) or ""


def _help_text(text: str) -> str:
    """Return a command's help with its indented examples as blocks of code."""
    shown, code = [], list[str]()
    for line in [*inspect.cleandoc(text).splitlines(), "."]:
        if line.startswith("    ") or (not line and code):
            code.append(line.strip())
            continue
        if any(code):
            shown.append("\n".join(["```console", *(f"$ {each}" for each in code if each), "```", ""]))
        code = []
        shown.append(line)
    return "\n".join(shown[:-1])


def markdown_table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of Markdown; line breaks and bars in cells are mended."""
    lines = [heading, ["---"] * len(heading), *rows]
    return "".join(f"| {' | '.join(_plain(cell).replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def _plain(text: str) -> str:
    return " ".join(text.split())
