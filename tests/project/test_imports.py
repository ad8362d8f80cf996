"""The import contracts of pyproject.toml hold, and flying modules start without the heavy packages."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_import_contract_is_kept() -> None:
    command = [Path(sys.executable).parent / "lint-imports", "--no-cache", "--no-logo"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_what_flies_loads_no_design_or_plotting_package() -> None:
    program = (
        "import sys, firmware_model.session.vehicle_endpoint;"
        "import gustproof.flight.routes.direct, gustproof.flight.endpoint.endpoint;"
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert "numba" in loaded
    assert not {"control", "matplotlib", "rosbags", "slycot"} & set(loaded)


def test_the_checker_names_its_types() -> None:
    files = (ROOT / "src" / "gustproof" / "checker").glob("*.py")
    assert not [
        path.name for path in files if re.search(r"^from typing import.*\bAny\b", path.read_text(), re.MULTILINE)
    ]
