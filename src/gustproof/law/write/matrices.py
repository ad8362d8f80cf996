"""Read and write laws as MATLAB files and as folders of tables.

Either holds A, B, C, D, G, H, limits, and the metadata dt, name, output, provenance. To read one, A, B, C, D and dt
are enough. B and D may have the gyro's three columns alone, six with the reference, or eight with roll and pitch by
gravity. Defaults are G = 0, H = 0, no limits, torque. A law that limits the rate commanded from attitude also has S, T,
U, V and rate_limits. A scheduled one has J, K, L, P, Q and schedule_limits, and the metadata parameters.
"""

import json
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import TEXT, parse_json, read_bytes, read_text, tell_kind
from firmware_model.config.validation import sanitize_line
from firmware_model.config.whole_file import whole_file, write_folder
from gustproof.law.form import SCHEDULE_MATRICES, Law, LawFileError, Output, Provenance, RateLimit, Schedule, load_law
from gustproof.law.write.mat_file import read_mat

_REQUIRED = ("A", "B", "C", "D")
_RATE_MATRICES = ("S", "T", "U", "V")
_TABLES = (
    *(*_REQUIRED, "G", "H", "limits", *_RATE_MATRICES, "rate_limits"),
    *(*SCHEDULE_MATRICES, "schedule_limits"),
)
_METADATA_FILE = "facts.json"
_METADATA = ("dt", "name", "output", "provenance", "parameters")
_IN_MAT = (*_TABLES, *_METADATA)
_CSV = 4 << 20  # [bytes] of a table
_NO_LIMIT = float(np.finfo(np.float64).max)

Matrix = NDArray[np.float64]


def read_law(name_or_path: str) -> Law:
    """Read a law: a shipped one by its name, a law file (.json), a MATLAB file (.mat), or a folder of tables.

    Raises
    ------
    LawFileError
        If there is no such law, a part is missing, or a shape or value is not allowed.
    """
    path = Path(name_or_path)
    if path.suffix == ".mat":
        return load_mat(path)
    return load_csv(path) if name_or_path and path.is_dir() else load_law(name_or_path)


def save_mat(law: Law, path: Path) -> None:
    """Write a law as a MATLAB file; there `ss(A, B, C, D, dt)` is a linear law from `y` to command.

    A scheduled law has its kinematics in G: linear at level attitude, it has `A(:, 4:6) + G` in A.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import load_law, load_mat, save_mat
    >>> with TemporaryDirectory() as folder:
    ...     save_mat(load_law("pid-fair"), Path(folder) / "law.mat")
    ...     load_mat(Path(folder) / "law.mat").name
    'pid-fair'
    """
    import scipy.io  # here: each command reads a law, few write a MATLAB file

    content: Any = BytesIO()
    scipy.io.savemat(content, _tables(law) | _metadata(law))
    with whole_file(path) as file:
        file.write(content.getbuffer())


def load_mat(path: Path) -> Law:
    """Read a law from a MATLAB file of version 5 to 7.2.

    Raises
    ------
    LawFileError
        If the file can't be read, a variable is missing or no matrix of numbers or row of text, or a shape or value is
        not allowed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import load_law, load_mat, save_mat
    >>> with TemporaryDirectory() as folder:
    ...     save_mat(load_law("hinf-d1"), Path(folder) / "law.mat")
    ...     load_mat(Path(folder) / "law.mat").order
    9
    """
    try:
        content = read_mat(read_bytes(path, TEXT), _IN_MAT)
    except OSError as error:
        raise LawFileError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise LawFileError(f"{path}: not a MATLAB file of version 5 to 7.2: {sanitize_line(str(error))}") from None
    if texts := [name for name in _TABLES if isinstance(content.get(name), str)]:
        raise LawFileError(f"{path}: {texts[0]}: is text, must be numbers")
    metadata = {name: content[name] for name in _METADATA if name in content}
    numbers = {name: value.reshape(-1) for name, value in metadata.items() if not isinstance(value, str)}
    words = {name: value for name, value in metadata.items() if isinstance(value, str) and value}
    return _build_law(path, content, {**words, **{name: each[0].item() for name, each in numbers.items() if len(each)}})


def save_csv(law: Law, folder: Path) -> None:
    """Write a law as a new folder: a table for each matrix, metadata as JSON; numbers are kept to the bit."""
    texts = {_METADATA_FILE: json.dumps(_metadata(law), indent=2) + "\n"}
    for name, table in _tables(law).items():
        rows = np.atleast_2d(table).tolist()
        texts[f"{name}.csv"] = "".join(",".join(map(repr, row)) + "\n" for row in rows)
    write_folder(folder, texts)


def load_csv(folder: Path) -> Law:
    """Read a law from a folder of tables.

    Raises
    ------
    LawFileError
        If a file can't be read, one is missing, or a shape or value is not allowed.
    """
    tables, path = {}, folder
    try:
        for path in (folder / f"{name}.csv" for name in _TABLES):
            if path.exists():
                rows = [line.split(",") for line in read_text(path, _CSV).splitlines()]
                tables[path.stem] = np.array([[float(cell) for cell in row] for row in rows])
        path = folder / _METADATA_FILE
        metadata = parse_json(read_text(path))
    except FileNotFoundError:
        raise LawFileError(
            f"{folder}: a folder without {_METADATA_FILE} holds no tables of a law{tell_kind(folder)}"
        ) from None
    except OSError as error:
        raise LawFileError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise LawFileError(f"{path}: {sanitize_line(str(error))}") from None
    return _build_law(folder, tables, metadata if isinstance(metadata, dict) else {})


def _tables(law: Law) -> dict[str, Matrix]:
    tables = {name: getattr(law, name) for name in (*_REQUIRED, "G", "H", "limits")}
    if law.rate_limit is not None:
        tables |= {name: getattr(law.rate_limit, name) for name in _RATE_MATRICES}
        tables["rate_limits"] = law.rate_limit.limits
    if law.schedule is not None:
        tables |= {name: getattr(law.schedule, name) for name in SCHEDULE_MATRICES}
        tables["schedule_limits"] = law.schedule.limits
    return tables


def _metadata(law: Law) -> dict[str, Any]:
    provenance = json.dumps(law.to_dict()["provenance"], ensure_ascii=False)
    metadata = {"dt": law.dt, "name": law.name, "output": law.output.value, "provenance": provenance}
    return metadata if law.schedule is None else {**metadata, "parameters": " ".join(law.schedule.parameters)}


def _build_law(path: Path, tables: Mapping[str, Any], metadata: Mapping[str, Any]) -> Law:
    if missing := [name for name in _REQUIRED if name not in tables] + [
        name for name in ("dt",) if name not in metadata
    ]:
        raise LawFileError(f"{path}: {missing[0]}: missing")
    try:
        matrices = {name: np.asarray(tables[name], dtype=np.float64) for name in _TABLES if name in tables}
        n = len(matrices["A"])
        provenance = parse_json(metadata.get("provenance", "null")) or {
            "design": f"read from {path.name}",
            "vehicle": "",
        }
        return Law(
            name=str(metadata.get("name", path.stem)),
            A=matrices["A"], B=_pad_reference(matrices["B"]), C=matrices["C"], D=_pad_reference(matrices["D"]),
            G=matrices.get("G", np.zeros((n, 3))), H=matrices.get("H", np.zeros((n, 3))),
            dt=float(metadata["dt"]),
            limits=matrices.get("limits", np.full(3, _NO_LIMIT)).reshape(-1),
            output=Output(metadata.get("output", Output.TORQUE.value)),
            provenance=Provenance(**provenance), rate_limit=_rate_limit(matrices),
            schedule=_schedule(matrices, str(metadata.get("parameters", "")).split()),
        )  # fmt: skip
    except (ValueError, TypeError) as error:
        raise LawFileError(f"{path}: {sanitize_line(str(error))}") from None


def _rate_limit(matrices: Mapping[str, Matrix]) -> RateLimit | None:
    part = _part(matrices, (*_RATE_MATRICES, "rate_limits"), "a limit of the rate")
    if part is None:
        return None
    S, T, U, V, limits = part
    return RateLimit(S=S, T=_pad_reference(T), U=U, V=V, limits=limits.reshape(-1))


def _schedule(matrices: Mapping[str, Matrix], parameters: list[str]) -> Schedule | None:
    part = _part(matrices, (*SCHEDULE_MATRICES, "schedule_limits"), "a schedule")
    if part is None:
        return None
    J, K, L, P, Q, limits = part
    return Schedule(parameters=tuple(parameters), J=J, K=_pad_reference(K), L=L, P=P, Q=Q, limits=limits.reshape(-1))


def _part(matrices: Mapping[str, Matrix], names: tuple[str, ...], what: str) -> list[Matrix] | None:
    """Return the matrices of an optional part of a law; `None` without any."""
    if missing := [name for name in names if name not in matrices]:
        if len(missing) < len(names):
            raise ValueError(f"{missing[0]}: missing, {what} has {', '.join(names)}")
        return None
    return [matrices[name] for name in names]


def _pad_reference(matrix: Matrix) -> Matrix:
    """Return a matrix with a reference's columns of 0 where only the gyro's three are given."""
    return np.hstack([matrix, np.zeros_like(matrix)]) if matrix.ndim == 2 and matrix.shape[1] == 3 else matrix
