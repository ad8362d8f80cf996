"""Reference pages as Markdown, made from what the program itself uses: models, message tables, docstrings."""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any

import gustproof
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording import journal
from firmware_model.session.vehicle_endpoint import HEARTBEAT_US, VehicleEndpoint
from gustproof.guide.schemas import Schema, attribute_docs, describe_keys, describe_values, file_schema
from gustproof.law.form import FORMAT, Law, Provenance, RateLimit, Schedule
from gustproof.recording.definitions import COMMAND_AGE, FLIGHT, MODE, definition, rotors_message
from gustproof.recording.topics import ESTIMATE_TOPICS, TOPICS

_EDITORS = (
    "`gustproof guide --schemas DIR` writes these tables as JSON Schemas. An editor that knows TOML, such as VS Code "
    "with Even Better TOML, completes and checks keys by them. Begin the file with "
    "`#:schema DIR/{kind}.schema.json`.\n\n"
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
    return _table(("key", "values", "default", "meaning"), rows)


def json_fields() -> str:
    """Return the reference of what `--json` prints."""
    parts = [
        "# Fields of JSON output\n\nEvery command that reports has `--json`. It prints one document on standard "
        "output, and nothing else. Units stand at the end of the names: `_deg`, `_s`, `_nm`. Numbers that are not "
        "finite are `null`.\n"
    ]
    for command, title, path in _DOCUMENTS:
        module, _, name = path.rpartition(".")
        kind = getattr(import_module(module), name)
        table = _document_table(kind) if "to_dict" in vars(kind) else _attributes_table(kind, "field")
        parts.append(f"## {title}\n\n{command}\n\n{table}")
    return "\n".join(parts)


_DOCUMENTS = (
    ("`gustproof fly --json`", "A flight", "gustproof.simulate.flight.Flight"),
    (
        "Figures of one flight, in `fly`, `analyse` and the tables of a campaign.",
        "Figures",
        "gustproof.scoring.metrics.Metrics",
    ),
    ("An entry of `requirements`.", "A requirement", "gustproof.scoring.requirements.RequirementResult"),
    ("`gustproof analyse --json`", "An analysis", "gustproof.analysis.analyse.Analysis"),
    ("`gustproof judge --json`", "A judgement", "gustproof.analysis.judge.Judgement"),
    ("`gustproof design --json`", "A design", "gustproof.synthesis.derive.DesignReport"),
    ("`gustproof tune --json`", "A tuning", "gustproof.synthesis.tune.Tuning"),
    (
        "`gustproof certify --json`, for a design",
        "A certificate of a gain",
        "gustproof.certify.certificate.Certificate",
    ),
    (
        "`gustproof certify --json`, for a law",
        "A certificate of a flight",
        "gustproof.certify.boundedness.FlightCertificate",
    ),
    ("`gustproof campaign --json`", "A campaign", "gustproof.campaign.statistics.CampaignStatistics"),
    ("`gustproof campaign --rare --json`", "A rare event", "gustproof.campaign.rare.RareEstimate"),
    ("`gustproof compare --json`, one entry a row", "A comparison", "gustproof.simulate.comparison.ComparisonRow"),
    ("`gustproof check-controller --json`, an entry of `findings`", "A finding", "gustproof.simulate.findings.Finding"),
    ("`gustproof league --json`", "A league", "gustproof.league.season.League"),
    ("`gustproof reproduce --json`", "A reproduction", "gustproof.reproduce.run.Reproduction"),
)
"""Command, title and model of each document."""


def _document_table(kind: type) -> str:
    """Return the keys of a class's `to_dict`, each with the docstring of the attribute that it is made from."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(vars(kind)["to_dict"])))
    outer = [node for node in ast.walk(tree) if isinstance(node, ast.Dict)]
    inner = {child for node in outer for value in node.values for child in ast.walk(value)}
    rows = [row for node in outer if node not in inner for row in _document_rows(node, attribute_docs(kind))]
    return _table(("field", "meaning"), rows) if rows else _attributes_table(kind, "field")


def _document_rows(node: ast.Dict, docs: Mapping[str, str], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield the keys of a dictionary in source, those of dictionaries in it with the names above them."""
    for key, value in zip(node.keys, node.values, strict=True):
        source = re.search(r"self\.(\w+)", ast.unparse(value))
        meaning = docs.get(source[1], "") if source else ""
        name = f"{above}{key.value!s}" if isinstance(key, ast.Constant) else ""
        if isinstance(value, ast.Dict):
            yield from _document_rows(value, docs, f"{name}.")
        elif name:
            yield f"`{name}`", meaning
        elif source and "asdict" in ast.unparse(value):
            yield f"keys of `{source[1]}`", meaning
        else:  # such as **({} if … else {"key": …})
            for part in (part for part in ast.walk(value) if isinstance(part, ast.Dict)):
                yield from _document_rows(part, docs, above)


def _attributes_table(kind: type, heading: str) -> str:
    names = [field.name for field in fields(kind)] if is_dataclass(kind) else list(getattr(kind, "_fields", ()))
    docs = attribute_docs(kind)
    return _table((heading, "meaning"), [(f"`{name}`", docs.get(name, "")) for name in names])


def bag_topics() -> str:
    """Return the reference of a recording: its topics, message types of our own, and the journal's fields."""
    meanings = dict(re.findall(r'\("(\w+)", "<f8"[^#\n]*# (.+)', inspect.getsource(journal)))
    rows = [
        (
            f"`{topic.name}`",
            f"`{topic.message}`",
            f"`{topic.frame_id}`",
            "; ".join(f"`{name}`: {meanings.get(name, 'told by a real autopilot')}" for name in topic.fields),
        )
        for topic in (*TOPICS, *ESTIMATE_TOPICS)
    ]
    own = {name: definition(name)[0].partition("=" * 80)[0] for name in (FLIGHT, MODE, rotors_message(4), COMMAND_AGE)}
    return "\n".join(
        [
            "# Topics of a recording\n\nA flight is recorded as a rosbag2 folder with one MCAP file. ROS 2 tools, "
            "Foxglove and PlotJuggler open it. It is equal to the flight's journal bit for bit. N is north, east, "
            "down; B is forward, right, down. `/flight` and `/mode` hold what is told once and at changes.\n",
            _table(("topic", "type", "frame", "fields of the journal"), rows),
            *(f"## {name}\n\n```text\n{text.strip()}\n```\n" for name, text in own.items()),
        ]
    )


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
            "`gustproof autopilot --params`.\n",
            "## Messages that the vehicle sends\n",
            _table(("message", "id", "interval by default", "fields"), sent),
            "## Messages that it reads\n",
            _table(("message", "id", "fields"), read),
            "## Commands that it obeys or refuses with a reason\n",
            _table(("command", "id", "meaning in MAVLink"), commands),
        ]
    )


def _interval(interval_us: int | None) -> str:
    return "on request" if interval_us is None else f"{interval_us / 1000:g} ms"


def _message_fields(message: Any) -> str:
    units = message.fieldunits_by_name
    return ", ".join(f"{name}{f' [{units[name]}]' if name in units else ''}" for name in message.fieldnames)


def python_api() -> str:
    """Return the reference of the public names of the package, from signatures and docstrings."""
    names = sorted(set(dir(gustproof)) - {"__version__"}, key=str.lower)
    parts = [
        "# Python API\n\nAll names are imported from `gustproof`. The examples are run by the tests. "
        "[The library page](library.md) shows a whole way through them.\n",
        _table(
            ("name", "purpose"),
            [(f"[`{name}`](#{name.lower()})", _first_line(getattr(gustproof, name))) for name in names],
        ),
    ]
    for name in names:
        value = getattr(gustproof, name)
        parts.append(f"## {name}\n\n```python\n{_signature(name, value)}\n```\n\n{_docstring(value.__doc__ or '')}")
        if inspect.isclass(value) and (rows := list(_class_rows(value))):
            parts.append(_table(("attribute", "meaning"), rows))
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


def command_options(commands: Mapping[str, Any], context: Callable[[str, Any], Any], helps: Mapping[str, str]) -> str:
    """Return the reference of the command line from its click commands, by their full names.

    `context` makes the click context of a command by its name. `helps` has the texts of those that parse their own
    options.
    """
    parts = [
        "# Options of every command\n\nThe same text as `--help` of each command. Exit statuses and the purpose of "
        "each are on [the page of commands](commands.md).\n"
    ]
    for name, command in commands.items():
        usage = command.get_usage(context(name, command)).removeprefix("Usage: ")
        rows = [_option_row(parameter) for parameter in command.params if not getattr(parameter, "hidden", False)]
        parts.append(f"## {name}\n\n```console\n{' '.join(usage.split())}\n```\n\n{_help_text(command.help or '')}\n")
        if name in helps:
            parts.append(f"```text\n{helps[name].strip()}\n```\n")
        elif rows:
            parts.append(_table(("option", "default", "meaning"), rows))
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


def _table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heading, ["---"] * len(heading), *rows]
    return "".join(f"| {' | '.join(_plain(cell).replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def _plain(text: str) -> str:
    return " ".join(text.split())
