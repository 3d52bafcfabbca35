"""Read JSON documents."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

from leactl.errors import InputError
from leactl.runfile.importing.sources.source import SourceRequest
from leactl.runfile.importing.sources.trees import TreeSource
from leactl.yamlfile import shown

ENDINGS = (".json",)
MAX_JSON_BYTES = 1 << 30  # of a file, whose content takes about five times as much memory


def open_source(path: Path, request: SourceRequest) -> TreeSource:
    """Open a JSON file."""
    return TreeSource(path, json_tree(path))


def json_tree(path: Path) -> Any:
    """Read a JSON document; NaN is accepted for missing values.

    Raises
    ------
    InputError : the file is too large, not UTF-8 or not JSON, or has a key twice in one object.
    """

    def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        """Build an object; Python's reader would silently take the last value of a repeated key.

        Raises
        ------
        InputError : a key is repeated.
        """
        if len(content := dict(pairs)) < len(pairs):
            ((repeated_key, _),) = Counter(name for name, _ in pairs).most_common(1)
            raise InputError(f"{path}: {shown(repeated_key)} stands twice in one object; each key once was expected")
        return content

    if (size := path.stat().st_size) > MAX_JSON_BYTES:
        raise InputError(f"{path}: {size} bytes of JSON; at most {MAX_JSON_BYTES} are read, use CSV or MAT")
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=unique_keys)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 at byte {error.start}") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{path}:{error.lineno}:{error.colno}  not JSON: {error.msg}") from None
    except ValueError as error:  # a whole number of thousands of digits
        raise InputError(f"{path}: not JSON that can be read: {str(error).partition(';')[0]}") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply") from None
