"""Wrong inputs of every command: a status, one clear line, no traceback, no `nan` as a result."""

import json
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.law.form import load_law

pytestmark = pytest.mark.plain

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
fly --repeat nowhere
fly --repeat folder
fly --repeat paper.toml
fly paper --repeat folder
fly --run nowhere.parquet:3
fly --run text.parquet:3
fly --run text.parquet
fly --run text.parquet:-1
fly --run :::
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
design
design D99
design D1 --gamma 0
design D1 --gamma -1
design D1 --gamma nan
design D1 --gamma inf
design D1 --gamma 1e-9
design D1 --backoff 1
design D1 --backoff nan
design D1 --gamma 1 --backoff 2
design D1 --order 3
design D1 --method hinfstruct
design D1 --method nothing
design D1 --method hinfstruct --order 0
design D1 --method hinfstruct --order -3
design D1 --method hinfstruct --order 4
design D1 -o x.txt
design D1 -o nowhere/x.json
design D1 --vehicle bike
design R1 --inner none.toml
design R1 --inner empty.toml
design empty.toml
design nan.toml
analyse
analyse nothing
analyse unstable.json --vehicle bike
analyse hinf-d1 --scenario nowhere
analyse hinf-d1 -o x.pdfx
analyse hinf-d1 --seed -3
analyse broken.json
certify
certify nothing
certify hinf-d2 --angle-rad nan --rate-rad-s 1
certify hinf-d2 --angle-rad -1 --rate-rad-s 1
certify hinf-d2 --angle-rad 1
certify hinf-d2 --angle-rad 9 --rate-rad-s 1
certify hinf-rates --angle-rad .1 --rate-rad-s .5
certify pid-fair --angle-rad .1 --rate-rad-s .5
certify hinf-d2 --moment x
certify hinf-d2 --moment 1,2
certify hinf-d2 --moment nan,1,1
certify hinf-d2 --horizon 1e9
certify hinf-d2 --horizon nan
certify hinf-d2 --horizon -1
certify hinf-d2 --moment-class some
certify --check none.json
certify --check broken.json
certify --check empty.json
certify --check deep.json
certify --check folder
certify hinf-d1 --air nowhere
certify hinf-d1 --air paper-turbulence --risk 2
certify hinf-d1 --air paper-turbulence --risk nan
certify unstable.json --horizon 10
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
campaign
campaign paper
campaign nowhere -o x.parquet
campaign paper -o x.csv
campaign paper -o x.parquet --runs 0
campaign paper -o x.parquet --runs -3
campaign paper -o x.parquet --runs x
campaign paper -o x.parquet --spread wind
campaign paper -o x.parquet --sampling grid
campaign paper -o x.parquet --workers 0
campaign paper -o text.parquet --law hinf-d1
campaign paper -o x.parquet --law nothing
campaign paper -o x.parquet --law hinf-d1 --executor nothing
campaign paper -o x.parquet --law hinf-d1 --gust-spread nan
campaign paper -o x.parquet --law hinf-d1 --rare 'peak > 1'
campaign paper -o x.toml --law hinf-d1 --rare 'peak_deg > nan'
campaign paper -o x.toml --law hinf-d1 --rare 'peak_deg'
campaign paper -o x.parquet --law hinf-d1 --controller 'exec: true'
campaign paper -o nowhere/x.parquet --law hinf-d1
compare nowhere --autopilot px4
compare paper --autopilot px5
report
report nowhere
report folder
report text.parquet
report folder -o x.txt
report text.parquet folder
report short.mcap
recover nowhere
recover folder
recover text.bin
export
export nothing --c x.c
export hinf-d1
export hinf-d1 --c x.txt
export hinf-d1 --c nowhere/x.c
export hinf-d1 --c x.c --rate 0
export hinf-d1 --c x.c --rate -5
export hinf-d1 --c x.c --attitude theirs
export hinf-d1 --px4 folder
export K.mat --law x.json
export folder --law x.json
tune
tune nowhere
tune iris --law nothing
tune iris --slew 0
tune iris --slew nan
tune iris --ms 1
tune iris --ms nan
tune iris --for px5
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
identify-rates
identify-rates -o x.json
identify-rates --connect here -o x.toml
audit
audit nothing
audit none.py
audit broken.py
league --entries nothing
league nothing
check-controller
check-controller nothing
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
league --runs 0
league --workers 0
league --vehicle bike
league --scenario nowhere
league --entry nothing
league --csv nowhere/x.csv
league --latex x.txt
compare paper --autopilot px4 --runs 0
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
identify-rates -o x.toml --bind-port 70000
identify-rates -o x.toml --signing-key none
check-controller 'exec: true' --vehicle bike
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
