"""Wind or moments of a recorded flight, as CSV for a scenario's `replay`."""

import csv
from io import TextIOWrapper
from pathlib import Path

from firmware_model.config.whole_file import whole_file
from gustproof.flight.recording.bag import Records

_COLUMNS = {"wind": ("gust_B", ("u_mps", "v_mps", "w_mps")), "moment": ("moment_B", ("L_nm", "M_nm", "N_nm"))}
KINDS = tuple(_COLUMNS)
"""Kinds of replay: the gusts, or the whole disturbance moment, of gusts and script."""


def save_replay(records: Records, kind: str, path: Path) -> None:
    """Write the gusts [m/s] or the disturbance moment [N*m] of a flight, both in B, kept to the bit.

    Angular gusts and the mean wind are not included.

    Raises
    ------
    OSError
        If the file can't be written.
    """
    field, names = _COLUMNS[kind]
    with whole_file(path) as file:
        stream = TextIOWrapper(file, encoding="utf-8", newline="")
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("time_s", *names))
        for time_us, values in zip(records["time_us"].tolist(), records[field].tolist(), strict=True):
            table.writerow((time_us * 1e-6, *values))
        stream.detach()
