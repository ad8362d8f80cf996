"""Hostile files lead to one printable line, exit status 2, little memory, and nothing written.

The files have names that are paths, terminal control sequences, gigabytes in small archives, or no end.
"""

import errno
import gc
import json
import os
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from typer.testing import CliRunner

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import VEHICLES, load_vehicle
from firmware_model.recording.journal import WIDTH, JournalWriter
from gustproof.cli.app import app
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.flight import FlightPlan
from gustproof.law.form import LAWS, load_law

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="devices, pipes and peaks of memory as Linux has them")

GIB = 1 << 30
Files = Callable[[Path], tuple[str, ...]]
"""Writes hostile files into a folder, and returns the command line that reads them."""
CASES: dict[str, Files] = {}
LAW = json.loads((LAWS / "hinf-d1.json").read_text())
HEAD = 'description = "x"\nduration_s = 1.0\n'
TURBULENT = FlightPlan(load_scenario("calm"), load_law("hinf-d1"), load_vehicle("paper"), 1, False)


def case(name: str) -> Callable[[Files], Files]:
    def keep(files: Files) -> Files:
        assert name not in CASES
        CASES[name] = files
        return files

    return keep


def law_file(name: str, content: str | bytes | Callable[[Path], object], file: str = "law.json") -> None:
    @case(f"law: {name}")
    def files(folder: Path) -> tuple[str, ...]:
        _write(folder / file, content)
        return "fly", "calm", "--law", file, "--output", "out"


def scenario_file(name: str, content: str | bytes | Callable[[Path], object], file: str = "mine.toml") -> None:
    @case(f"scenario: {name}")
    def files(folder: Path) -> tuple[str, ...]:
        _write(folder / file, content)
        return ("scenario", "check", file) if "check" in name else ("fly", file, "--law", "hinf-d1", "--output", "out")


def _write(path: Path, content: str | bytes | Callable[[Path], object]) -> None:
    if callable(content):
        content(path)
    else:
        path.write_bytes(content.encode() if isinstance(content, str) else content)


def changed(**changes: Any) -> str:
    return json.dumps({**LAW, **changes})


def zero(path: Path) -> None:
    path.symlink_to("/dev/zero")


def sparse(size: int) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        path.touch()
        os.truncate(path, size)

    return write


# Laws

for title, name in {
    "absolute": "/somewhere/abs", "upward": "x/../../y", "up": "..", "hidden": ".bashrc", "empty": "", "blank": " ",
    "backslash": "a\\b", "escape": "\x1b]0;owned\x07", "newline": "a\nb", "long": "a" * 100_000, "bidi": "a\u202eb",
    "C1": "\x9b31m", "NUL": "a\x00b", "number": 7, "list": ["a"], "null": None, "formula": "$^$", "wide": "风" * 34,
}.items():  # fmt: skip
    law_file(f"name is {title}", changed(name=name))
law_file("name is half a character", changed(name="@").replace("@", "\\ud800"))
law_file("name of the file", "{", "\x1b[31m\n.json")
law_file("nested lists", "[" * 100_000 + "]" * 100_000)
law_file("nested objects", '{"a":' * 100_000 + "1" + "}" * 100_000)
law_file("nested 150 deep", changed(A="@").replace('"@"', "[" * 150 + "]" * 150))
law_file("dt of 400 digits", changed(dt=10**400))
law_file("limit of 400 digits", changed(limits=[1.0, 1.0, 10**400]))
law_file("dt of 5000 digits", changed(dt="@").replace('"@"', "9" * 5000))
law_file("dt is no number", changed(dt=float("nan")))
law_file("limits are texts", changed(limits=["1.0", "1.0", "1.0"]))
law_file("limits are a text", changed(limits="1.0"))
law_file("matrix of texts", changed(D=[["1.0"] * 6] * 3))
law_file("ragged matrix", changed(A=[[1.0], [1.0, 2.0]]))
law_file("provenance is a text", changed(provenance="me"))
law_file("provenance of half a character", changed(provenance={"design": "@", "vehicle": ""}).replace("@", "\\udfff"))
law_file("design is a list", changed(provenance={"design": ["x"], "vehicle": ""}))
law_file("figures are texts", changed(provenance={"design": "", "vehicle": "", "parameters": {"gamma": "1\x1b"}}))
law_file("figures are a number", changed(provenance={"design": "", "vehicle": "", "parameters": 3}))
law_file("unknown key that commands", changed(**{"\x1b[2J": 1}))
law_file("empty file", "")
law_file("16 MiB of lists", lambda path: path.write_text("[" + ",".join(["[]"] * 5_500_000) + "]"))
law_file("16 MiB of keys", lambda path: path.write_text("{" + ",".join(f'"{i:x}":1' for i in range(1_500_000)) + "}"))
law_file("too large", sparse(17 << 20))
law_file("endless hole", sparse(1 << 36))
law_file("device", zero)
law_file("pipe", os.mkfifo)
law_file("folder", Path.mkdir)
law_file("link to itself", lambda path: path.symlink_to(path))
law_file("byte order mark", b"\xef\xbb\xbf" + changed().encode())
law_file("Latin-1", changed(name="B\xf6e").encode().replace(b"\\u00f6", b"\xf6"))

# Scenarios

for title, name in {
    "absolute": "/somewhere/abs",
    "upward": "../../x",
    "escape": "\\u001b[2J",
    "long": "a" * 5000,
}.items():
    scenario_file(f"name is {title}", f'name = "{name}"\n{HEAD}')
scenario_file("name of the file", HEAD, "a\x1b[31m\nb.toml")
scenario_file("nested lists", f"{HEAD}x = " + "[" * 100_000)
scenario_file("key of 100,000 parts", HEAD + "a." * 100_000 + "b = 1")
scenario_file("400 digits", 'description = "x"\nduration_s = 1' + "0" * 400)
scenario_file("hexadecimal of 100,000 digits, check", 'description = "x"\nduration_s = 0x' + "f" * 100_000)
scenario_file("100,000 tables, check", HEAD + "[[wind]]\n" * 100_000)
scenario_file("100,000 keys, check", HEAD + "".join(f"k{i} = 1\n" for i in range(100_000)))
scenario_file("one table for many, check", f'{HEAD}[wind]\nkind = "dryden"\nintensity = "light"\n')
scenario_file("unknown key that commands, check", f'{HEAD}"\\u001b[2J" = 1\n')
scenario_file("byte order mark, check", b"\xef\xbb\xbf" + HEAD.encode())
scenario_file("Latin-1, check", 'description = "B\xf6e"\nduration_s = 1.0\n'.encode("latin-1"))
scenario_file("event after the end, check", f'{HEAD}[[event]]\nkind = "mode"\nmode = "hold"\nat_s = 100.0\n')
scenario_file(
    "gust after the end, check",
    f'{HEAD}[[wind]]\nkind = "step"\nspeed_mps = 3.0\nfrom_deg = 0.0\nstart_s = 50.0\n',
)
scenario_file("drift of a held vehicle, check", f'{HEAD}[[require]]\nmetric = "drift_m"\nat_most = 1.0\n')
scenario_file("too large, check", sparse(3 << 20))
scenario_file("device, check", zero)
scenario_file("pipe", os.mkfifo)


def replayed(name: str, content: str | Callable[[Path], object] | None, named: str = "wind.csv") -> None:
    @case(f"replay: {name}")
    def files(folder: Path) -> tuple[str, ...]:
        (folder / "mine.toml").write_text(f'{HEAD}[[wind]]\nkind = "replay"\nfile = "{named}"\n')
        if content is not None:
            _write(folder / "wind.csv", content)
        return "scenario", "check", "mine.toml"


TIMES = "time_s,north_mps,east_mps,down_mps\n"
replayed("device", None, "/dev/zero")
replayed("terminal's own", None, "\\u001b[2J.csv")
replayed("pipe", os.mkfifo)
replayed("folder", Path.mkdir)
replayed("too large", sparse(17 << 20))
replayed("endless hole", sparse(1 << 36))
replayed("200,000 rows", TIMES + "".join(f"{i},0,0,0\n" for i in range(200_000)))
replayed("a line of 10 MiB", TIMES + "0," * (5 << 20))
replayed("a quote that is never closed", TIMES + '"' + "0\n" * 1_000_000)
replayed("a cell that commands", TIMES + "0,\x1b[2J,0,0\n")


@case("replay: one file a thousand times")
def a_thousand_tables(folder: Path) -> tuple[str, ...]:
    (folder / "wind.csv").write_text(TIMES + "".join(f"{i},0,0,0\n" for i in range(1000)))
    (folder / "mine.toml").write_text(HEAD + '[[wind]]\nkind = "replay"\nfile = "wind.csv"\n' * 1000)
    return "scenario", "check", "mine.toml"


# Vehicles


@case("vehicle: inertias of no body")
def no_body(folder: Path) -> tuple[str, ...]:
    text = (VEHICLES / "iris.toml").read_text()
    begin, end = text.index("inertia_B"), text.index("]\n", text.index("inertia_B"))
    (folder / "mine.toml").write_text(f"{text[:begin]}inertia_B = [0.02, 0.02, 0.4{text[end:]}")
    return "fly", "calm", "--law", "hinf-d1", "--vehicle", "mine.toml", "--output", "out"


@case("vehicle: device")
def no_vehicle(folder: Path) -> tuple[str, ...]:
    zero(folder / "mine.toml")
    return "campaign", "fly", "calm", "--law", "hinf-d1", "--vehicle", "mine.toml", "-o", "mc.parquet"


# Recordings


def record(operation: int, body: bytes) -> bytes:
    return struct.pack("<BQ", operation, len(body)) + body


def chunk(content: bytes, claimed: int, name: bytes = b"zstd") -> bytes:
    head = struct.pack("<QQQII", 0, 0, claimed, 0, len(name)) + name
    return record(0x06, head + struct.pack("<Q", len(content)) + content)


def mcap(*records: bytes) -> bytes:
    magic, end = b"\x89MCAP0\r\n", record(0x0F, bytes(4)) + record(0x02, bytes(20))
    return magic + record(0x01, struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)) + b"".join(records) + end + magic


@cache
def bomb(size: int) -> bytes:
    press, zeros = zstd.ZstdCompressor(level=1), bytes(64 << 20)
    return b"".join(press.compress(zeros) for _ in range(size // len(zeros))) + press.flush()


def bag(name: str, content: Callable[[], bytes] | Callable[[Path], object], *, made: bool = True) -> None:
    for command in (
        ("report", "bag"),
        ("replay", "bag", "--output", "out"),
        ("scenario", "extract", "bag", "-o", "a.csv"),
    ):

        @case(f"bag: {name}: {command[0]}")
        def files(folder: Path, command: tuple[str, ...] = command) -> tuple[str, ...]:
            (folder / "bag").mkdir()
            (folder / "bag" / "metadata.yaml").write_text("")
            _write(folder / "bag" / "bag.mcap", content() if made else content)  # type: ignore[arg-type, call-arg]
            return command


bag("chunk of 3 GiB", lambda: mcap(chunk(bomb(3 * GIB), 3 * GIB)))
bag("chunk of 3 GiB that claims a MiB", lambda: mcap(chunk(bomb(3 * GIB), 1 << 20)))
bag("2000 chunks of a MiB", lambda: mcap(*[chunk(zstd.compress(bytes(1 << 20)), 1 << 20)] * 2000))
bag("record of 2**60", lambda: mcap(struct.pack("<BQ", 0x06, 1 << 60)))
bag("no end", lambda: mcap()[:-9])
bag("device", zero, made=False)
bag("pipe", os.mkfifo, made=False)
bag("hole", sparse(1 << 36), made=False)


def flown(name: str, note: dict[str, Any]) -> None:
    @case(f"bag: {name}")
    def files(folder: Path) -> tuple[str, ...]:
        records = np.zeros(10, dtype=np.dtype(("V", 8 * WIDTH))).view(_record())
        records["time_us"] = np.arange(10) * 4000.0
        write_bag(folder / "bag", records, note)
        return "replay", "bag", "--output", "out"

    @case(f"journal: {name}")
    def journal(folder: Path) -> tuple[str, ...]:
        (folder / "out").mkdir()
        with JournalWriter(folder / "out" / "x.journal", {"note": note}) as writer:
            writer.append(np.zeros(WIDTH))
        return "report", "out"


def _record() -> Any:
    from firmware_model.recording.journal import RECORD

    return RECORD


NOTE = json.loads(json.dumps(TURBULENT.metadata()))
flown("law's name is a path", {**NOTE, "law": {**NOTE["law"], "name": "x/../../../evil"}})
flown("scenario's name is a path", {**NOTE, "scenario": {**NOTE["scenario"], "name": "/tmp/evil"}})
flown("vehicle's name commands", {**NOTE, "vehicle": {**NOTE["vehicle"], "name": "\x1b[2J"}})
flown("another note", {"seed": "\x1b"})


def journal(name: str, content: bytes | Callable[[Path], object]) -> None:
    @case(f"journal: {name}")
    def files(folder: Path) -> tuple[str, ...]:
        (folder / "out").mkdir()
        _write(folder / "out" / "x.journal", content)
        return "report", "out"


journal("pipe", os.mkfifo)
journal("device", zero)
journal("endless header", sparse(1 << 36))
journal("deep header", b"[" * 100_000 + b"\n")


@case("journal: endless hole behind a header")
def endless_journal(folder: Path) -> tuple[str, ...]:
    (folder / "out").mkdir()
    path = folder / "out" / "x.journal"
    path.write_text(json.dumps({"note": {"scenario": 1}}) + "\n")
    os.truncate(path, 1 << 36)
    return "report", "out"


# Laws of other tools, tables, certificates


def packed(content: bytes) -> bytes:
    head = b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    return head + struct.pack("<II", 15, len(content)) + content


@cache
def zeros_in_zlib(size: int) -> bytes:
    """Return so many zeros, of which only the first two parts are compressed: from the second on all are alike."""
    press, zeros = zlib.compressobj(1), bytes(16 << 20)
    first, other = (press.compress(zeros) + press.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    empty, checksum = b"\3\0", struct.pack(">I", size % 65521 << 16 | 1)
    return first + other * (size // len(zeros) - 1) + empty + checksum


def matlab(name: str, content: Callable[[Path], object]) -> None:
    @case(f"matlab: {name}")
    def files(folder: Path) -> tuple[str, ...]:
        content(folder / "law.mat")
        return "analyse", "law.mat"


matlab("a GiB in zlib", lambda path: path.write_bytes(packed(zeros_in_zlib(GIB))))
matlab("device", zero)
matlab("pipe", os.mkfifo)
matlab("cells", lambda path: scipy.io.savemat(path, {"A": np.array([1, "x"], dtype=object)}))
matlab("nothing in dt", lambda path: scipy.io.savemat(path, {**{k: np.eye(3) for k in "ABCD"}, "dt": np.zeros(0)}))


@case("tables: pipe")
def piped_tables(folder: Path) -> tuple[str, ...]:
    (folder / "law").mkdir()
    os.mkfifo(folder / "law" / "A.csv")
    return "export", "law", "-o", "x.json"


@case("tables: device")
def endless_tables(folder: Path) -> tuple[str, ...]:
    (folder / "law").mkdir()
    zero(folder / "law" / "facts.json")
    return "export", "law", "-o", "x.json"


def parquet(name: str, content: Callable[[Path], object]) -> None:
    @case(f"parquet: {name}")
    def files(folder: Path) -> tuple[str, ...]:
        content(folder / "mc.parquet")
        return "report", "mc.parquet"


def table(note: str) -> Callable[[Path], object]:
    rows = pa.table({"run": [1, 2]}, metadata={"gustproof": note})
    return lambda path: pq.write_table(rows, path)


parquet("pipe", os.mkfifo)
parquet("device", zero)
parquet("deep note", table("[" * 100_000))
parquet("other rows than its note says", table('{"runs": 1000000000, "laws": [1, 2, 3]}'))


def certificate(name: str, content: str | Callable[[Path], object]) -> None:
    @case(f"certificate: {name}")
    def files(folder: Path) -> tuple[str, ...]:
        _write(folder / "c.json", content)
        return "certify", "check", "c.json"


certificate("broken", '{"format":')
certificate("another document", '{"format": "\x7f"}')
certificate("deep", "[" * 100_000)
certificate("device", zero)
certificate("pipe", os.mkfifo)


@pytest.fixture(autouse=True)
def seldom_collected() -> Iterator[None]:
    """Collect garbage as seldom as the command does, see `gustproof.__main__`: it takes most of the time else."""
    usual = gc.get_threshold()
    gc.set_threshold(100_000)
    yield
    gc.set_threshold(*usual)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place = tmp_path / "a" / "b"
    place.mkdir(parents=True)
    monkeypatch.chdir(place)
    return place


def everything(root: Path) -> set[Path]:
    return set(root.rglob("*"))


def memory(key: str) -> int:
    """Return the memory of this process now, `VmRSS`, or at its peak, `VmHWM` [bytes]."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return 1024 * int(lines[key].split()[0])


def assert_refused(status: int, output: str, errors: str, arguments: tuple[str, ...] = ()) -> None:
    assert status == 2, (status, output, errors)
    lines = errors.splitlines()
    assert len(lines) == 1 or arguments[:2] == ("scenario", "check")  # the latter prints a line for each error
    assert all(line.isprintable() and line.startswith("gustproof") for line in lines)
    assert 0 < len(errors) < 6000
    assert output.replace("\n", "").isprintable()


def test_there_are_at_least_sixty_hostile_files() -> None:
    assert len(CASES) >= 60


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", CASES)
def test_hostile_file_is_refused_in_one_printable_line(name: str, folder: Path, tmp_path: Path) -> None:
    arguments = CASES[name](folder)
    before = everything(tmp_path)
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins here
    begin = memory("VmRSS")
    result = CliRunner().invoke(app, arguments)
    assert not isinstance(result.exception, Exception), result.exception
    assert memory("VmHWM") - begin < 0.8 * GIB  # the interpreter and its modules take the rest
    assert_refused(result.exit_code, result.stdout, result.stderr, arguments)
    assert everything(tmp_path) == before


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    "name",
    ["law: name is absolute", "law: 16 MiB of keys", "replay: device", "bag: chunk of 3 GiB that claims a MiB: report"],
)
def test_hostile_file_on_a_real_command_line_takes_less_than_a_gigabyte(
    name: str, folder: Path, tmp_path: Path
) -> None:
    arguments = CASES[name](folder)
    before = everything(tmp_path)
    with (tmp_path / "out").open("w+") as output, (tmp_path / "err").open("w+") as errors:
        process = subprocess.Popen([sys.executable, "-m", "gustproof", *arguments], stdout=output, stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert_refused(process.returncode, (tmp_path / "out").read_text(), (tmp_path / "err").read_text(), arguments)
    assert usage.ru_maxrss * 1024 < GIB
    assert everything(tmp_path) - before == {tmp_path / "out", tmp_path / "err"}


def run(*command: str) -> tuple[int, str, str]:
    ended = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, timeout=60, check=False)
    return ended.returncode, ended.stdout, ended.stderr


@pytest.mark.parametrize("program", ["firmware_model", "gustproof.flight.endpoint"])
def test_processes_refuse_hostile_files_in_one_printable_line(program: str, folder: Path) -> None:
    name = "\x1b[31m\n.json"
    (folder / name).write_text(changed(name="/abs"))
    status, output, errors = run(program, "--scenario" if program == "firmware_model" else "--law", name)
    assert (status, output) == (2, "")
    (line,) = errors.splitlines()
    assert line.isprintable()
    status, _, errors = run(program, "\x1b[2J")
    assert status == 2
    assert errors.replace("\n", "").isprintable()


def test_words_of_files_that_are_sound_do_not_command_a_terminal(folder: Path) -> None:
    (folder / "mine.toml").write_text(f"# \x9b31m \u202e\n{HEAD}")
    shown = CliRunner().invoke(app, ["scenario", "show", "mine.toml"])
    assert shown.stdout == f"# \\x9b31m \\u202e\n{HEAD}"
    strange = CliRunner().invoke(app, ["report", "\x1b[2J"])
    assert_refused(strange.exit_code, strange.stdout, strange.stderr)
    superfluous = CliRunner().invoke(app, ["scenario", "check", "mine.toml", "\x1b[2J"])
    assert superfluous.exit_code == 2
    assert superfluous.stderr.replace("\n", "").isprintable()


def test_full_disk_is_told_with_the_name_of_the_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for synced, file in enumerate(("law.json", "law.png")):
        shutil.rmtree(folder)
        folder.mkdir()
        left = [synced]

        def sync(number: int, left: list[int] = left) -> None:
            """Fill the disk when the file of this turn is synced to it."""
            left[0] -= 1
            if left[0] < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patch:
            patch.setattr("firmware_model.config.whole_file.os.fsync", sync)
            result = CliRunner().invoke(app, ["design", "hinfsyn", "D1", "-o", str(folder / "law.json")])
        *progress, line = result.stderr.splitlines()  # on a busy machine a line of progress comes first
        assert all(each.startswith("gustproof: ") and each.endswith(" s") for each in progress)
        assert (result.exit_code, line) == (2, f"gustproof: {folder / file}: No space left on device")
        assert not (folder / file).exists()
