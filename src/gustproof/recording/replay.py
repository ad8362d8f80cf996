"""What the air did in a recorded flight, as CSV that a scenario's `replay` reads."""

import csv
from pathlib import Path

from gustproof.recording.bag import Records

_COLUMNS = {
    "wind": ("gust_B", ("u_mps", "v_mps", "w_mps")),
    "moment": ("moment_B", ("L_nm", "M_nm", "N_nm")),
}
KINDS = tuple(_COLUMNS)
"""What can be replayed: the gusts, or the whole disturbance moment, theirs and the scripted one."""


def save_replay(records: Records, kind: str, path: Path) -> None:
    """Write the gusts [m/s] or the disturbance moment [N*m] of a flight, both in B, to a new file, kept to the bit.

    Angular gusts are not among them, nor is the mean wind.

    Raises
    ------
    OSError
        If the file exists, or can't be written.
    """
    field, names = _COLUMNS[kind]
    with path.open("x", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("time_s", *names))
        for time_us, values in zip(records["time_us"].tolist(), records[field].tolist(), strict=True):
            table.writerow((time_us * 1e-6, *values))
