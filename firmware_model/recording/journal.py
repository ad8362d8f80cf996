"""Journal of a flight: one record of fixed size per sample, appended in flight. All recordings are made from it.

The file starts with one line of JSON: scenario, vehicle and seed by name, and the metadata to make a recording or to
repeat the flight. Records of little-endian float64 follow; `rotors` in the header says how many thrusts they hold, if
not four. A flight that is cut off leaves a journal that is intact up to its last record.
"""

import json
import mmap
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import TEXT, open_regular, parse_json
from firmware_model.config.vehicle import MOST_ROTORS
from firmware_model.errors import ConfigError
from firmware_model.recording.durable_file import AppendOnlyFile

RECORD = np.dtype(
    [
        ("time_us", "<f8"),  # [us] model time of the sample
        ("gyro_B", "<f8", 3),  # [rad/s] measured rate, a float32
        ("specific_force_B", "<f8", 3),  # [m/s^2] measured, a float32
        ("torque_command_B", "<f8", 3),  # [N*m] actuator command from this sample to the next
        ("omega_command_B", "<f8", 3),  # [rad/s] command of the on-board rate loop; NaN without one
        ("torque_B", "<f8", 3),  # [N*m] actual torque of the actuators
        ("position_N", "<f8", 3),  # [m] north, east, down
        ("velocity_N", "<f8", 3),  # [m/s]
        ("q_NB", "<f8", 4),  # attitude B to N, Hamilton, scalar first
        ("omega_B", "<f8", 3),  # [rad/s]
        ("gust_B", "<f8", 3),  # [m/s] gust, blowing toward, from this sample to the next
        ("gust_omega_B", "<f8", 3),  # [rad/s] angular gust
        ("moment_B", "<f8", 3),  # [N*m] disturbance moment from this sample to the next; in free flight at this sample
        ("thrust_z_command", "<f8", (1,)),  # [N] B, z: minus the collective thrust command
        ("thrust_z", "<f8", (1,)),  # [N] B, z: minus the actual thrust; on the test stand it only turns the rotors
        ("rotors", "<f8", 4),  # [N] thrust of each rotor
        ("wind_N", "<f8", 3),  # [m/s] mean wind, blowing toward
        ("command_age", "<f8", (1,)),  # [samples] age of the acting command, by its stamp; NaN without one
        ("mode", "<f8"),  # autopilot mode, firmware_model.autopilot.modes.Mode
    ]
)
"""Record of a vehicle with four rotors."""
WIDTH = RECORD.itemsize // 8
"""Count of its numbers."""
_BLOCK = 1 << 12  # records, 2 MB: a block of a bag, which is made of them, takes six times as much
_LONG = 1 << 16  # records of a journal that is left in its file: each such file stays open

# Offset of each field, in numbers.
_OFFSETS = {name: RECORD.fields[name][1] // 8 for name in RECORD.names or ()}  # type: ignore[index]
TIME, GYRO_B, FORCE_B = _OFFSETS["time_us"], _OFFSETS["gyro_B"], _OFFSETS["specific_force_B"]
TORQUE_COMMAND, TORQUE_B = _OFFSETS["torque_command_B"], _OFFSETS["torque_B"]
OMEGA_COMMAND = _OFFSETS["omega_command_B"]
POSITION, VELOCITY, Q_NB, OMEGA = _OFFSETS["position_N"], _OFFSETS["velocity_N"], _OFFSETS["q_NB"], _OFFSETS["omega_B"]
GUST, GUST_OMEGA, MOMENT, WIND = _OFFSETS["gust_B"], _OFFSETS["gust_omega_B"], _OFFSETS["moment_B"], _OFFSETS["wind_N"]
THRUST_COMMAND, THRUST, ROTORS = _OFFSETS["thrust_z_command"], _OFFSETS["thrust_z"], _OFFSETS["rotors"]


@cache
def record_type(rotors: int) -> np.dtype[np.void]:
    """Return the record of a vehicle with `rotors`: `RECORD`, or for other than four with their thrusts at its end.

    All other fields stay where they are; the place of the four thrusts is `unused`, NaN.
    """
    if rotors == 4:
        return RECORD
    fields = [("unused" if name == "rotors" else name, *rest) for name, *rest in RECORD.descr]
    return np.dtype([*fields, ("rotors", "<f8", rotors)])


def as_records(rows: NDArray[np.float64]) -> NDArray[np.void]:
    """Return rows (n, numbers) of records as such: (n,) of the `record_type` of that width."""
    rotors = 4 if rows.shape[1] == WIDTH else rows.shape[1] - WIDTH
    return rows.view(record_type(rotors))[:, 0]


class JournalWriter:
    """Writer of a new journal file; as a context manager it leaves the file complete.

    A crash of the process can lose `buffer_records`: by default a second at 250 Hz. A `record` is of float64; that of
    a vehicle is stated in the header.

    Raises
    ------
    OSError
        If the file can't be created.
    RecordingError
        If the disk is full; earlier records stay readable.
    """

    def __init__(
        self, path: Path, header: Mapping[str, Any], buffer_records: int = 250, record: np.dtype[np.void] = RECORD
    ) -> None:
        self._path, self._flushed = path, 0
        self._file = AppendOnlyFile(path)
        if record != RECORD and "rotors" in (record.names or ()):
            header = {"rotors": record["rotors"].shape[0], **header}
        self._file.write(json.dumps(header, separators=(",", ":")).encode() + b"\n")
        self._block = np.empty((buffer_records, record.itemsize // 8))
        self._used = 0

    def append(self, record: NDArray[np.float64] | Sequence[float]) -> None:
        """Append the numbers of one record, (WIDTH,) of a `RECORD`, or of several, (n, WIDTH)."""
        rows = np.atleast_2d(record)
        while len(rows):
            taken = rows[: len(self._block) - self._used]
            self._block[self._used : self._used + len(taken)] = taken
            self._used, rows = self._used + len(taken), rows[len(taken) :]
            if self._used == len(self._block):
                self.flush()

    def flush(self) -> None:
        """Hand all records so far to the operating system."""
        used, self._used = self._used, 0  # records that a full disk has rejected are not written again
        self._file.write(self._block[:used].tobytes())
        self._flushed += used

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.flush()
        finally:
            self._file.close()
            if kind is not None and not self._flushed:  # refused before it began: the next try finds no journal
                self._path.unlink(missing_ok=True)


def read_journal(path: Path, *, sound: bool = False) -> tuple[dict[str, Any], NDArray[np.void]]:
    """Return a journal's header and its complete records, (n,) of its `record_type`, without a cut-off last one.

    If `sound`, the records end where time no longer increases: a lost disk cache leaves zeros. More than 65,536 records
    are not read but mapped, read-only: they are in memory while they are used, see `record_blocks`. Their file may be
    removed, but not cut off.

    Raises
    ------
    ConfigError
        If the file can't be read or is not a journal.
    """
    header = None
    try:
        with open_regular(path) as file:
            header = parse_json(file.readline(TEXT))
            records = _read_records(file, told_type(header))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ValueError:
        header = None
    if not isinstance(header, dict):
        raise ConfigError(f"{path}: not a journal")
    return header, records[: _end_of_time(records)] if sound else records


def told_type(header: Any) -> np.dtype[np.void]:
    """Return the record that a journal's header tells.

    Raises
    ------
    ValueError
        If no vehicle has as many rotors.
    """
    rotors = header.get("rotors", 4) if isinstance(header, dict) else 4
    if not (isinstance(rotors, int) and 4 <= rotors <= MOST_ROTORS):
        raise ValueError(f"rotors is {rotors}, must be a number from 4 to {MOST_ROTORS}")
    return record_type(rotors)


def _read_records(file: IO[bytes], record: np.dtype[np.void]) -> NDArray[np.void]:
    """Return the complete records (n,) from a file's position on."""
    begin = file.tell()
    count = (os.fstat(file.fileno()).st_size - begin) // record.itemsize
    if count > _LONG:
        content = mmap.mmap(file.fileno(), begin + count * record.itemsize, access=mmap.ACCESS_READ)
        return np.ndarray(count, record, content, begin)
    return np.frombuffer(bytearray(file.read(count * record.itemsize)), record)


def record_blocks(records: NDArray[np.void], size: int = _BLOCK) -> Iterator[NDArray[np.void]]:
    """Yield `records` (n,) in blocks of `size`; no more than one block of a mapped journal stays in memory."""
    mapped: Any = records
    while isinstance(mapped, np.ndarray):
        mapped = mapped.base
    for begin in range(0, len(records), size):
        block = records[begin : begin + size]
        yield block.copy() if isinstance(mapped, mmap.mmap) else block
        if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):  # not every system has it
            mapped.madvise(mmap.MADV_DONTNEED)


def _end_of_time(records: NDArray[np.void]) -> int:
    """Return the first record at which time does not increase, or their number if it always does."""
    before, done = -np.inf, 0
    for block in record_blocks(records):
        breaks = np.flatnonzero(~(np.diff(block["time_us"], prepend=before) > 0.0))
        if len(breaks):
            return done + int(breaks[0])
        before, done = float(block["time_us"][-1]), done + len(block)
    return done


def count_records(path: Path, rotors: int = 4) -> int:
    """Return the number of complete records of a vehicle with `rotors` in a journal that may grow or not exist yet."""
    try:
        with path.open("rb") as file:
            header = file.readline()
            size = os.fstat(file.fileno()).st_size
    except FileNotFoundError:
        return 0
    return (size - len(header)) // record_type(rotors).itemsize if header.endswith(b"\n") else 0
