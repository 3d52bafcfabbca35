"""Read and change tags, the words by which people mark runs, in `tags.json` in the folder of the run files.

Run files are not changed: tags change often and say nothing about the measurement (docs/decisions/0018).
"""

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError

from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.runfile.publish import replacement
from leactl.runfile.summary import Summary, is_run_name
from leactl.yamlblock import Block
from leactl.yamlfile import shown

NAME: Final = "tags.json"
MOST_TAG_BYTES: Final = 1 << 26  # of a file of tags: a million runs
TAG_PATTERN: Final = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}"
Tag = Annotated[str, Field(pattern=f"^{TAG_PATTERN}$")]


class TagFile(Block):
    """The tags of a folder, each with its runs, identified by `run_id` or, without one, by file name."""

    format: Literal["leactl-tags"] = "leactl-tags"
    format_version: Literal[1] = 1
    tags: dict[Tag, tuple[str, ...]] = {}

    def by_run(self) -> dict[str, tuple[str, ...]]:
        """Return the tags of each run in alphabetical order."""
        tags_by_run: dict[str, tuple[str, ...]] = {}
        for tag in sorted(self.tags):
            for run in self.tags[tag]:
                tags_by_run[run] = (*tags_by_run.get(run, ()), tag)
        return tags_by_run

    def changed(self, tag: str, runs: Sequence[str], remove: bool) -> "TagFile":
        """Return a copy in which `tag` was added to runs, or removed from them."""
        runs_before = self.tags.get(tag, ())
        runs_after = sorted({*runs_before} - {*runs} if remove else {*runs_before, *runs})
        other_tags = {name: members for name, members in self.tags.items() if name != tag}
        return self.model_copy(update={"tags": other_tags | ({tag: tuple(runs_after)} if runs_after else {})})


def with_tags(directory: Path, runs: Sequence[Summary], remark: Callable[[str], None]) -> list[Summary]:
    """Return runs with the tags of their folder; if the tags cannot be read, call `remark` and return them untagged."""
    try:
        tags = read_tags(directory).by_run()
    except InputError as fault:
        remark(f"{fault}; no tags are known")
        return list(runs)
    return [run._replace(tags=tags[name]) if (name := tag_key_of(run)) in tags else run for run in runs]


def change_tags(paths: Sequence[Path], tag: str, remove: bool) -> list[Summary]:
    """Add a tag to runs, or remove it from them; return the runs with their new tags.

    The tags of all folders are read before those of any are written: a damaged file of tags leaves all as they were.

    Raises
    ------
    InputError : the tag is not an allowed word, a run cannot be read, or the file of tags is damaged or cannot be
        written.
    """
    refuse_bad_tag(tag)
    from leactl.runfile.catalog.summaries import summary  # imports h5py, which a list from an index does not need

    runs = [summary(path) for path in paths]
    if faults := [run.fault for run in runs if run.fault]:
        raise InputError(faults)
    folders: dict[Path, list[Summary]] = {}
    for run in runs:
        folders.setdefault(run.folder.resolve(), []).append(run)  # one key for each folder, which is locked only once
    with ExitStack() as locks:
        for folder in sorted(folders):  # all processes lock in the same order, so that they cannot block each other
            locks.enter_context(locked(folder))
        new_tag_files = {
            folder: read_tags(folder).changed(tag, [tag_key_of(run) for run in members], remove)
            for folder, members in folders.items()
        }
        for folder, file in new_tag_files.items():
            with replacement(folder / NAME) as path:
                path.write_text(json.dumps(file.model_dump(), indent=1) + "\n", encoding="utf-8")
    tags_by_run = {folder: file.by_run() for folder, file in new_tag_files.items()}
    return [run._replace(tags=tags_by_run[run.folder.resolve()].get(tag_key_of(run), ())) for run in runs]


def refuse_bad_tag(tag: str) -> None:
    """Raise InputError if a word cannot be a tag, for example a run file because the tag was forgotten."""
    if is_run_name(tag) or not re.fullmatch(TAG_PATTERN, tag):
        raise InputError(
            f"{shown(tag)} is no tag; a word of letters, digits, '_', '-' and '.' was expected behind the runs"
        )


def tag_key_of(run: Summary) -> str:
    """Return the key of a run in the file of tags: its `run_id`, else its file name."""
    return run.run_id or run.file


def read_tags(directory: Path) -> TagFile:
    """Read the tags of a folder; empty if it has no such file.

    Raises
    ------
    InputError : the file is damaged, or has another format or version.
    """
    path = directory / NAME
    if not os.path.lexists(path):
        return TagFile()
    try:
        with open_regular(path, MOST_TAG_BYTES) as file:
            return TagFile.model_validate(json.loads(file.read()))
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from None
    except ValidationError as fault:
        first_error = fault.errors(include_url=False)[0]
        key_path = ".".join(map(str, first_error["loc"]))
        raise InputError(f"{path}: {f'{key_path}: ' if key_path else ''}{first_error['msg']}") from None
    except (ValueError, RecursionError) as fault:
        raise InputError(f"{path}: is damaged: {' '.join(str(fault).split())}") from None


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder while the block runs, so that no other process changes its tags.

    Some network folders and systems without POSIX cannot lock; there, the later of two simultaneous changes remains.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
