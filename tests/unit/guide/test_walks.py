"""Commands of the guide that take less than a second are run as they stand; the slow ones are walked elsewhere."""

import re
import shlex
from importlib.resources import files
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app

pytestmark = pytest.mark.plain
GUIDE = Path(str(files("gustproof.guide")))
QUICK = (
    "scenario list", "scenario show paper", "scenario check", "law list", "law show", "vehicle list", "vehicle show",
    "design list", "export hinf-scheduled --c", "guide --schemas", "--version",
)  # fmt: skip


def commands(page: str) -> list[str]:
    """Return the quick commands of a page."""
    blocks = re.findall(r"^```console\n(.*?)^```", (GUIDE / f"{page}.md").read_text(encoding="utf-8"), re.M | re.S)
    lines = [line.removeprefix("$ gustproof ") for line in "".join(blocks).splitlines()]
    return [line for line in lines if line.startswith(QUICK)]


@pytest.mark.parametrize("page", ["commands", "scenario", "export"])
def test_the_quick_commands_of_a_page_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (scenario,) = re.findall(r"^```toml\n(.*?)^```", (GUIDE / "scenario.md").read_text(encoding="utf-8"), re.M | re.S)
    for name in ("day.toml", "mine.toml"):
        (tmp_path / name).write_text(scenario, encoding="utf-8")
    lines = commands(page)
    assert lines
    for line in lines:
        result = CliRunner().invoke(app, shlex.split(line))
        assert result.exit_code == 0, f"{line}: {result.output}"


def test_no_command_hides_in_a_block_of_text() -> None:
    for path in GUIDE.glob("*.md"):
        for block in re.findall(r"^```text\n(.*?)^```", path.read_text(encoding="utf-8"), re.M | re.S):
            assert not re.search(r"^(\$|gustproof|pip|python) ", block, re.M), path.name
