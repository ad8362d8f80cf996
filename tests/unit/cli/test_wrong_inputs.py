"""Wrong inputs of every command: a status, one clear line, no traceback, no `nan` as a result."""

import json
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.law.form import load_law

WRONG = """
fly
fly nowhere
fly '' --law hinf-d1
fly paper --law ''
fly paper --law nothing
fly paper --law ../hinf-d1
fly paper --law empty.json
fly paper --law broken.json
fly paper --law list.json
fly paper --law deep.json
fly paper --law huge.json
fly paper --law surrogate.json
fly paper --law escape.json
fly paper --law slash.json
fly paper --law none.json
fly paper --law nan.json
fly paper --law shape.json
fly paper --law K.mat
fly paper --law folder
fly paper --law empty.params
fly paper --law text.bin
fly paper --seed -1
fly paper --seed 4294967296
fly paper --seed x
fly paper --seed nan
fly paper --vehicle bike
fly paper --vehicle plate.toml --law hinf-d1
fly paper --vehicle six.toml --law hinf-d1
fly paper --vehicle nan.toml --law hinf-d1
fly paper --vehicle empty.toml --law hinf-d1
fly paper --vehicle paper.txt --law hinf-d1
fly paper --instance 300 --autopilot px4
fly paper --instance 3
fly paper --law hinf-d1 --law pid-fair
fly paper --autopilot px5
fly paper --autopilot px4 --build nowhere
fly paper --autopilot px4 --controller x.py:make
fly paper --params none.params
fly paper --controller nothing
fly paper --controller none.py:make
fly paper --controller broken.py:make
fly paper --controller none.so
fly paper --controller 'exec:'
fly paper --controller 'exec: "'
fly paper --law hinf-d1 --controller empty.py:make
replay nowhere
replay folder
replay paper.toml
replay
campaign rerun nowhere.parquet:3
campaign rerun text.parquet:3
campaign rerun text.parquet
campaign rerun text.parquet:-1
campaign rerun :::
fly bom.toml --law hinf-d1
fly latin.toml --law hinf-d1
fly table.toml --law hinf-d1
fly unknown.toml --law hinf-d1
fly nan-time.toml --law hinf-d1
fly inf-time.toml --law hinf-d1
fly long.toml --law hinf-d1
fly abs.toml --law hinf-d1
fly dup.toml --law hinf-d1
fly folder --law hinf-d1
fly /dev/zero --law hinf-d1
fly zero.toml --law hinf-d1
fly paper extra --law hinf-d1
fly paper --output folder --law hinf-d1
fly paper --nothing
scenario check nowhere
scenario check bom.toml
scenario check late.toml
scenario check drift.toml
scenario check empty.toml
scenario show
scenario show nowhere
scenario shw paper
scenario extract nowhere -o x.csv
scenario extract folder -o x.csv
scenario extract folder -o x.txt
scenario extract folder
law show nowhere
law show broken.json
law show folder
law list extra
vehicle show nowhere
vehicle show plate.toml
vehicle show paper.toml
design hinfsyn D99
design hinfsyn D1 --gamma 0
design hinfsyn D1 --gamma -1
design hinfsyn D1 --gamma nan
design hinfsyn D1 --gamma inf
design hinfsyn D1 --gamma 1e-9
design hinfsyn D1 --backoff 1
design hinfsyn D1 --backoff nan
design hinfsyn D1 --gamma 1 --backoff 2
design hinfsyn D1 --order 3
design hinfstruct D1
design nothing D1
design hinfstruct D1 0
design hinfstruct D1 -3
design hinfstruct D1 4
design hinfsyn D1 -o x.txt
design hinfsyn D1 -o nowhere/x.json
design hinfsyn D1 --vehicle bike
design hinfsyn R1 --inner none.toml
design hinfsyn R1 --inner empty.toml
design empty.toml
design nan.toml
analyse
analyse nothing
analyse unstable.json --vehicle bike
analyse hinf-d1 --scenario nowhere
analyse hinf-d1 -o x.pdfx
analyse hinf-d1 --seed -3
analyse broken.json
certify box
certify box nothing
certify gain hinf-d2 --angle-rad nan --rate-rad-s 1
certify gain hinf-d2 --angle-rad -1 --rate-rad-s 1
certify gain hinf-d2 --angle-rad 1
certify gain hinf-d2 --angle-rad 9 --rate-rad-s 1
certify gain hinf-rates --angle-rad .1 --rate-rad-s .5
certify gain pid-fair --angle-rad .1 --rate-rad-s .5
certify box hinf-d2 --moment x
certify box hinf-d2 --moment 1,2
certify box hinf-d2 --moment nan,1,1
certify box hinf-d2 --horizon 1e9
certify box hinf-d2 --horizon nan
certify box hinf-d2 --horizon -1
certify box hinf-d2 --moment-class some
certify check none.json
certify check broken.json
certify check empty.json
certify check deep.json
certify check folder
certify air hinf-d1 nowhere
certify air hinf-d1 paper-turbulence --risk 2
certify air hinf-d1 paper-turbulence --risk nan
certify box unstable.json --horizon 10
wind-limit
wind-limit nothing
wind-limit iris --keep drift<3,rmse<1
wind-limit iris --keep tilt
wind-limit iris --keep tilt<nan
wind-limit iris --keep 'tilt<35 m'
wind-limit iris --keep tilt<35,tilt<30
wind-limit iris --risk 0
wind-limit iris --risk nan
wind-limit iris --workers 0
wind-limit iris --build nowhere
wind-limit iris -o x.pdf
wind-limit iris --law pid-fair
worst-case
worst-case nothing
worst-case hinf-d1 --moment 0,0,0
worst-case hinf-d1 --moment nan,1,1
worst-case hinf-d1 --moment 1,1
worst-case hinf-d1 --flights 0
worst-case hinf-d1 --flights x
worst-case hinf-d1 --horizon 0
worst-case hinf-d1 --horizon nan
worst-case hinf-d1 --limit nan
worst-case hinf-d1 -o x.json
worst-case unstable.json --flights 10 --horizon 1
campaign fly
campaign fly paper
campaign fly nowhere -o x.parquet
campaign fly paper -o x.csv
campaign fly paper -o x.parquet --runs 0
campaign fly paper -o x.parquet --runs -3
campaign fly paper -o x.parquet --runs x
campaign fly paper -o x.parquet --spread wind
campaign fly paper -o x.parquet --sampling grid
campaign fly paper -o x.parquet --workers 0
campaign fly paper -o text.parquet --law hinf-d1
campaign fly paper -o x.parquet --law nothing
campaign fly paper -o x.parquet --law hinf-d1 --workers nothing
campaign fly paper -o x.parquet --law hinf-d1 --spread gust=nan
campaign fly paper -o x.parquet --law hinf-d1 --spread gust=2
campaign fly paper -o x.parquet --law hinf-d1 --spread attitude=x
campaign fly paper -o x.parquet --law hinf-d1 --spread gyro=1
campaign fly paper -o x.parquet --law hinf-d1 -o x.txt
campaign rare paper 'peak > 1' --law hinf-d1
campaign rare paper 'peak_deg > nan' --law hinf-d1
campaign rare paper 'peak_deg' --law hinf-d1
campaign fly paper -o x.parquet --law hinf-d1 --controller 'exec: true'
campaign fly paper -o nowhere/x.parquet --law hinf-d1
compare nowhere --autopilot px4
compare paper --autopilot px5
report
report nowhere
report folder
report text.parquet
report folder -o x.txt
report text.parquet folder
report short.mcap
export
export nothing -o x.c
export hinf-d1
export hinf-d1 -o x.txt
export hinf-d1 -o nowhere/x.c
export hinf-d1 -o x.c --rate 0
export hinf-d1 -o x.c --rate -5
export hinf-d1 -o x.c --attitude theirs
export hinf-d1 --px4 folder
export K.mat -o x.json
export folder -o x.json
tune
tune nowhere
tune iris --law nothing
tune iris --slew 0
tune iris --slew nan
tune iris --ms 1
tune iris --ms nan
tune iris --from px5
tune iris --at-once
tune iris -o x.toml
judge
judge nothing
judge none.params
judge hinf-d1 --vehicle none
identify
identify none.ulg
identify text.bin -o x.toml
identify folder -o x.toml
identify empty.csv -o x.toml
identify text.bin --like no-such -o x.toml
identify rates
identify --connect here -o x.json
identify --connect here -o x.toml
audit
audit nothing
audit none.py
audit broken.py
controller check
controller check nothing
controller --law nothing
controller --connect here
controller --via smoke
controller --connect udp://:14540
controller --controller nothing
autopilot --instance 300
autopilot --instance x
autopilot --seed -1
autopilot --scenario nowhere
autopilot --vehicle bike
autopilot --bind nowhere.invalid
autopilot --bind 0.0.0.0
autopilot --bind-port 70000
autopilot --air nowhere
reproduce --seeds 0
reproduce --vehicle bike
reproduce --output folder
doctor extra
judge hinf-d1 --vehicle paper --air nowhere
judge hinf-d1 --vehicle paper --moment x
judge hinf-d1 --vehicle paper --moment nan,1,1
judge hinf-d1 --vehicle paper --seed -1
judge hinf-d1 --vehicle paper -o x.txt
judge hinf-d1 --vehicle paper -o nowhere/x.html
judge hinf-d1 --vehicle paper --better x.txt
compare paper --autopilot px4 --runs 0
compare paper nowhere --law flagship
compare course --law nothing
compare course --law flagship --law mine.py:make
compare paper --law "exec: node mine.mjs"
compare paper --autopilot px4 --vehicle bike
compare paper --autopilot px4 --build nowhere
tune iris --scenario nowhere
tune iris --slew inf
tune iris --slew x
tune iris --style none
tune iris -o nowhere/x.json
identify text.bin -o x.toml --from nan
identify text.bin -o x.toml --mass -1
identify text.bin -o x.toml --mass nan
identify text.bin -o x.toml --inertia 1,2
identify text.bin -o x.toml --thrust-max nan
identify text.bin -o x.toml --scenario nowhere
identify --connect 127.0.0.1:1 -o x.toml --bind-port 70000
identify --connect 127.0.0.1:1 -o x.toml --signing-key none.key
controller check 'exec: true' --vehicle bike
audit px4 --build nowhere
audit --nothing
doctor --nothing
guide nothing
guide install extra
law show
law lst
vehicle list extra
vehicle show --json
design list extra
design show nowhere
desgn
--nothing
""".strip().splitlines()

BASE = 'description = "x"\nduration_s = 10.0\n'
FILES = {
    "empty.json": "",
    "broken.json": "{",
    "list.json": "[1, 2]",
    "deep.json": "[" * 100_000,
    "empty.toml": "",
    "huge.json": '{"dt": 1' + "0" * 400 + "}",
    "surrogate.json": '{"name": "\\ud800"}',
    "empty.params": "",
    "text.bin": "no log",
    "text.parquet": "no table",
    "empty.py": "",
    "broken.py": "def",
    "empty.csv": "",
    "K.mat": "no matrix",
    "short.mcap": "\x89MCAP0\r\n",
    "plate.toml": "inertia_B = [0.02, 0.02, 0.4]\n",
    "nan.toml": "mass = nan\nleak = nan\n",
    "paper.toml": BASE,
    "table.toml": BASE + "[wind]\nkind = 'dryden'\n",
    "unknown.toml": BASE + "durations = 3\n",
    "dup.toml": BASE + BASE,
    "nan-time.toml": BASE.replace("10.0", "nan"),
    "inf-time.toml": BASE.replace("10.0", "inf"),
    "long.toml": BASE.replace("10.0", "1e9"),
    "abs.toml": 'name = "/tmp/abs"\n' + BASE,
    "zero.toml": BASE + '[[wind]]\nkind = "replay"\nfile = "/dev/zero"\n',
    "late.toml": BASE + '[[event]]\nkind = "kick"\nat_s = 100.0\nmoment_B = [1.0, 0.0, 0.0]\n',
    "bom.toml": "\ufeff" + BASE,
    "drift.toml": BASE + '[[require]]\nquantity = "drift_m"\nmax = 1.0\n',
    "six.toml": "rotors = 6\n",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of wrong files."""
    made = tmp_path_factory.mktemp("wrong")
    for name, text in FILES.items():
        (made / name).write_text(text, encoding="utf-8")
    (made / "latin.toml").write_bytes(BASE.encode() + b"# B\xf6e\n")
    (made / "folder").mkdir()
    (made / "folder" / "keep").touch()
    law = load_law("hinf-d1").to_dict()
    changes = {
        "unstable": {"A": [[2.0 * (i == j) for j in range(9)] for i in range(9)]},
        "nan": {"dt": None},
        "shape": {"B": [[1.0]]},
        "escape": {"name": "\x1b[2J"},
        "slash": {"name": "x/../../y"},
    }
    for name, change in changes.items():
        (made / f"{name}.json").write_text(json.dumps(law | change), encoding="utf-8")
    return made


@pytest.mark.parametrize("line", WRONG)
def test_wrong_input_is_one_clear_line_and_leaves_nothing(
    line: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.rglob("*"))
    result = CliRunner().invoke(app, shlex.split(line))
    said = result.stderr.strip()
    assert result.exception is None or isinstance(result.exception, SystemExit), repr(result.exception)
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    assert "\x1b[2J" not in result.output
    assert re.search(r"\bnan\b", result.stdout) is None
    lines = 20 if line.startswith("scenario check") else 1  # which has one for each mistake
    assert said.lower().startswith("usage: ") or 1 <= len(said.splitlines()) <= lines, said
    assert len(said) < 3000
    assert sorted(path.name for path in folder.rglob("*") if "pycache" not in str(path)) == before


def test_there_are_as_many_as_were_promised() -> None:
    assert len(set(WRONG)) == len(WRONG) >= 200
