"""Read the log of a flight, whatever wrote it: found by the first bytes of the file, else by its suffix."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from firmware_model.config.files import open_regular, tell_kind
from firmware_model.config.validation import sanitize_line
from firmware_model.errors import ConfigError
from gustproof.logs.read import betaflight, crazyflie, dataflash, ulog
from gustproof.logs.read.assemble import Draft, assemble
from gustproof.logs.read.betaflight import read_betaflight
from gustproof.logs.read.crazyflie import read_crazyflie
from gustproof.logs.read.dataflash import read_dataflash
from gustproof.logs.read.flight_log import FlightLog
from gustproof.logs.read.own_bag import read_own_bag
from gustproof.logs.read.table import read_table
from gustproof.logs.read.ulog import read_ulog

_DAMAGED = (ArithmeticError, LookupError, UnicodeError, struct.error)


def _read_tlog(path: Path) -> Draft:
    from gustproof.logs.read.tlog import read_tlog  # the dialect takes half a second to load

    return read_tlog(path)


_Reader = Callable[[Path], Draft]
_BY_MAGIC: dict[bytes, _Reader] = {
    b"\x89MCAP0\r\n": read_own_bag,
    ulog.MAGIC: read_ulog,
    dataflash.MAGIC: read_dataflash,
    dataflash.TEXT_MAGIC: read_dataflash,
    crazyflie.MAGIC: read_crazyflie,
    **dict.fromkeys(betaflight.MAGICS, read_betaflight),
}
_BY_SUFFIX: dict[str, _Reader] = {".csv": read_table, ".txt": read_table, ".tlog": _read_tlog}
_OTHERS = {
    b"H Product:": "a blackbox of Betaflight: decode it with `blackbox_decode`, and give the .csv",
    b"#ROSBAG": "a bag of ROS 1: give the autopilot's own log",
    b"SQLite format 3": "a bag of ROS 2 in SQLite: give the autopilot's own log",
    b"PK\x03\x04": "a zip: unpack it",
    b"\x1f\x8b": "compressed: unpack it",
}
_LONGEST_MAGIC = max(map(len, [*_BY_MAGIC, *_OTHERS]))
_KINDS = "ULog (.ulg), DataFlash (.bin, .log), .tlog, a bag of ours, a Crazyflie's uSD log or a .csv"


def read_log(path: Path) -> FlightLog:
    """Return the signals and facts of a flight's log.

    It may be a PX4 ULog, an ArduPilot DataFlash log, a MAVLink .tlog, or a bag of ours, folder or .mcap. Others are the
    binary log of a Crazyflie's uSD deck, the CSV of Betaflight's decoder, and others, see `gustproof.logs.read.table`.

    Raises
    ------
    ConfigError
        If it can't be read, is damaged, or has no gyro; one line that names the file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> from gustproof import read_log
    >>> rows = [(0.002 * i, 0.1 * i, 0.0, 0.0) for i in range(500)]
    >>> with TemporaryDirectory() as folder:
    ...     table = Path(folder) / "flight.csv"
    ...     np.savetxt(table, rows, delimiter=",", header="time_s,p_dps,q_dps,r_dps", comments="")
    ...     log = read_log(table)
    >>> log.gyro.values.shape, round(float(log.gyro.time[-1]), 3)
    ((500, 3), 0.998)
    >>> log.findings[0]
    'not in this log: command, motors, accelerometer, attitude, reference'
    """
    try:
        with np.errstate(all="ignore"):  # numbers of a damaged file overflow; they are left out
            return assemble(_find_reader(path)(path))
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or sanitize_line(str(error))}") from None
    except MemoryError:
        raise ConfigError(f"{path}: needs more memory than there is") from None
    except _DAMAGED:
        raise ConfigError(f"{path}: it is damaged") from None
    except ValueError as error:
        raise ConfigError(f"{path}: {sanitize_line(' '.join(str(error).split()))}") from None


def _find_reader(path: Path) -> _Reader:
    if path.is_dir():
        return read_own_bag
    with open_regular(path) as file:
        begin = file.read(_LONGEST_MAGIC)
    if not begin:
        raise ValueError("is empty")
    for magic, what in _OTHERS.items():
        if begin.startswith(magic):
            raise ValueError(f"it is {what}")
    reader = next((reader for magic, reader in _BY_MAGIC.items() if begin.startswith(magic)), None)
    reader = reader or _BY_SUFFIX.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"no flight log that is known; known are {_KINDS}{tell_kind(path)}")
    return reader
