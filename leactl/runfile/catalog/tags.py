"""Tags: words by which people find runs again, in a file beside the runs, whose own files stay as they are.

A tag is no finding about a run, as a note is, and changes often; docs/decisions/0018 says why it is in no run file.
"""

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError

from leactl.errors import InputError
from leactl.regular import open_regular
from leactl.runfile.publish import replacement
from leactl.runfile.summary import Summary, is_run_name
from leactl.yamlblock import Block
from leactl.yamlfile import shown

NAME: Final = "tags.json"
MOST_BYTES: Final = 1 << 26  # a million runs
WORD: Final = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}"
Tag = Annotated[str, Field(pattern=f"^{WORD}$")]


class TagFile(Block):
    """The tags of a folder, each with its runs: by `run_id`, or by the name of the file where a run has none."""

    format: Literal["leactl-tags"] = "leactl-tags"
    format_version: Literal[1] = 1
    tags: dict[Tag, tuple[str, ...]] = {}

    def by_run(self) -> dict[str, tuple[str, ...]]:
        """The tags of each run, as their letters sort."""
        found: dict[str, tuple[str, ...]] = {}
        for tag in sorted(self.tags):
            for run in self.tags[tag]:
                found[run] = (*found.get(run, ()), tag)
        return found

    def changed(self, tag: str, runs: Sequence[str], remove: bool) -> "TagFile":
        """The tags with one that was given to runs, or taken from them."""
        before = self.tags.get(tag, ())
        after = sorted({*before} - {*runs} if remove else {*before, *runs})
        kept = {name: members for name, members in self.tags.items() if name != tag}
        return self.model_copy(update={"tags": kept | ({tag: tuple(after)} if after else {})})


def with_tags(directory: Path, runs: Sequence[Summary], remark: Callable[[str], None]) -> list[Summary]:
    """Runs of a folder with their tags; a file that cannot be read is told, and the runs have none."""
    try:
        tags = read_tags(directory).by_run()
    except InputError as fault:
        remark(f"{fault}; no tags are known")
        return list(runs)
    return [run._replace(tags=tags[name]) if (name := name_of(run)) in tags else run for run in runs]


def change_tags(paths: Sequence[Path], tag: str, remove: bool) -> list[Summary]:
    """Give runs a tag, or take it from them; gives the runs with the tags that they have then.

    Raises
    ------
    InputError : no word for a tag, a run that cannot be read, or a file of tags that is damaged or cannot be written;
        nothing is changed then.
    """
    refuse_other_words(tag)
    from leactl.runfile.catalog.summaries import summary  # h5py, which a list that has an index does without

    runs = [summary(path) for path in paths]
    if faults := [run.fault for run in runs if run.fault]:
        raise InputError(faults)
    folders: dict[Path, list[Summary]] = {}
    for run in runs:
        folders.setdefault(run.folder, []).append(run)
    tags: dict[Path, dict[str, tuple[str, ...]]] = {}
    for folder, members in folders.items():
        with held(folder):
            changed = read_tags(folder).changed(tag, [name_of(run) for run in members], remove)
            with replacement(folder / NAME) as path:
                path.write_text(json.dumps(changed.model_dump(), indent=1) + "\n", encoding="utf-8")
        tags[folder] = changed.by_run()
    return [run._replace(tags=tags[run.folder].get(name_of(run), ())) for run in runs]


def refuse_other_words(tag: str) -> None:
    """Refuse what is no tag, above all the last run where the tag was forgotten."""
    if is_run_name(tag) or not re.fullmatch(WORD, tag):
        raise InputError(
            f"{shown(tag)} is no tag; a word of letters, digits, '_', '-' and '.' was expected behind the runs"
        )


def name_of(run: Summary) -> str:
    """What a run goes by in the file of tags."""
    return run.run_id or run.file


def read_tags(directory: Path) -> TagFile:
    """The tags of a folder; none where it has no file of them.

    Raises
    ------
    InputError : the file is damaged, or of another kind or version.
    """
    path = directory / NAME
    if not os.path.lexists(path):
        return TagFile()
    try:
        with open_regular(path, MOST_BYTES) as file:
            return TagFile.model_validate(json.loads(file.read()))
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from None
    except ValidationError as fault:
        first = fault.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"{path}: {f'{place}: ' if place else ''}{first['msg']}") from None
    except (ValueError, RecursionError) as fault:
        raise InputError(f"{path}: is damaged: {' '.join(str(fault).split())}") from None


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep other processes from changing the tags of a folder while the block lasts, where it can be locked.

    Some network folders cannot, nor can systems without POSIX: of two changes at once the later one stays there.
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
