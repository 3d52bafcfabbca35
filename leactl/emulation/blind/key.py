"""The key to a set of cases: the contents of each case, stored apart from the runs, and its hash, stored with the runs.

The hash is the SHA-256 of the key file, which contains a salt, so that nobody can find the key by hashing guesses.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from leactl.errors import InputError

KEY_NAME = "key.json"
HASH_NAME = "key.sha256"


def write_key(key_dir: Path, out: Path, entries: Mapping[str, Any], seed: int, salt: str) -> str:
    """Write the key, which has an entry for each case; write its hash into the folder of the runs and return it."""
    key = {
        "format": "leactl-gap-key",
        "format_version": 1,
        "salt": salt,
        "seed": str(seed),
        "cases": dict(entries),
    }
    key_text = json.dumps(key, indent=1) + "\n"
    key_dir.mkdir(parents=True, exist_ok=True)
    (key_dir / KEY_NAME).write_text(key_text, encoding="utf-8")
    digest = hashlib.sha256(key_text.encode()).hexdigest()
    (out / HASH_NAME).write_text(f"{digest}  {KEY_NAME}\n", encoding="utf-8")
    return digest


def require_whole(out: Path) -> None:
    """Raise if the cases of a folder are still being made: the key's hash is written last.

    Raises
    ------
    InputError : there is no hash.
    """
    if not (out / HASH_NAME).is_file():
        raise InputError(f"{out / HASH_NAME}: not there; `leactl gap blind make` writes it once every case is made")


def read_key(key_dir: Path, out: Path) -> dict[str, Any]:
    """Read the key and check it against the hash stored with the runs.

    Raises
    ------
    InputError : the key or the hash is missing, or the hash is not that of the key.
    """
    key_path, hash_path = key_dir / KEY_NAME, out / HASH_NAME
    for required_file in (key_path, hash_path):
        if not required_file.is_file():
            raise InputError(f"{required_file}: not there; give the folder that `leactl gap blind make` wrote")
    key_bytes = key_path.read_bytes()
    expected_hash = hash_path.read_text(encoding="utf-8").split()[0]
    if hashlib.sha256(key_bytes).hexdigest() != expected_hash:
        raise InputError(f"{key_path}: its SHA-256 is not the one in {hash_path}; it is not the key of these runs")
    key: dict[str, Any] = json.loads(key_bytes)
    return key
