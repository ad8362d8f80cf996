"""Hidden seeds: flights' seeds from a salt that the organiser keeps, and publishes after."""

import hashlib
import secrets
from collections.abc import Sequence
from pathlib import Path

from firmware_model.errors import ConfigError

PUBLIC_SALT = "gustproof league, public seeds"
"""Salt of a league without a hidden one: anybody can fly its seeds beforehand."""
_FEWEST = 12


def check_salt(salt: str) -> str:
    """Return a salt that can't be guessed from its commitment by trying short texts.

    Raises
    ------
    ConfigError
        If it is too short.
    """
    if len(salt) < _FEWEST:
        raise ConfigError(f"--salt: give {_FEWEST} characters at least: a shorter one is found by trying them all")
    return salt


def commit(salt: str) -> str:
    """Return the salt's commitment, its SHA-256 in hexadecimal digits."""
    return hashlib.sha256(salt.encode()).hexdigest()


def hidden_seeds(salt: str, scenario: str, vehicle: str, runs: int) -> Sequence[int]:
    """Return the seeds (runs,) in [0, 2^32) of a scenario's flights on a vehicle, the same for all entries."""
    texts = (f"{salt}\n{scenario}\n{vehicle}\n{run}" for run in range(runs))
    return [int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") for text in texts]


def keep_salt(folder: Path) -> str:
    """Return the salt that a league's folder keeps for its organiser alone; draw it, if there is none.

    Raises
    ------
    ConfigError
        If the folder can't be written.
    """
    path = folder / "salt.txt"
    try:
        folder.mkdir(exist_ok=True)
        if not path.exists():
            path.touch(mode=0o600)
            path.write_text(secrets.token_hex(16), encoding="ascii")
        return path.read_text(encoding="ascii")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None


def store_commitment(folder: Path, salt: str) -> None:
    """Write the commitment into a league's folder, before its first flight; a second salt's is added.

    Raises
    ------
    ConfigError
        If the folder can't be written.
    """
    path = folder / "commitments.txt"
    try:
        folder.mkdir(exist_ok=True)
        with path.open("a+", encoding="ascii") as file:
            file.seek(0)
            if commit(salt) not in file.read().split():
                file.write(f"{commit(salt)}\n")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
