"""`leactl docs`: the pages that come with the program, listed and printed."""

import json
from pathlib import Path

import typer

import leactl
from leactl.cli.helptext import examples, single_command
from leactl.errors import InputError

app = single_command()

INSTALLED_FOLDER = "share/doc/leactl"  # of the pages in an environment, as pyproject.toml states
FOLDERS = ("tutorial", "how-to", "reference", "explanation", "evidence")
KNOWN_PAGE = "reference/run-format.md"  # by which the folder of pages is recognised


def complete_page(incomplete: str) -> list[str]:
    """Return the names of pages that begin with the typed word, for shell completion; empty if none are installed."""
    try:
        folder = folder_of_pages()
    except InputError:
        return []
    return [name for name in pages_by_name(folder) if name.startswith(incomplete)]


@app.command(epilog=examples("docs", "docs safety"))
def docs(
    page: str = typer.Argument("", help="Print this page; without one all are listed.", autocompletion=complete_page),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout."),
) -> None:
    """List the pages of the manual and their folder, or print one page."""
    from leactl.report.terminal import list_line

    folder = folder_of_pages()
    paths = pages_by_name(folder)
    titles = {name: title(path) for name, path in paths.items()}
    if page and page not in titles:
        raise InputError(f"there is no page {page!r}; there are {', '.join(titles)}")
    if as_json:
        page_text = {"text": paths[page].read_text(encoding="utf-8")} if page else {}
        typer.echo(json.dumps({"folder": str(folder), "pages": titles, **page_text}))
    elif page:
        typer.echo(paths[page].read_text(encoding="utf-8"), nl=False)
    else:
        width = max(map(len, titles))
        lines = [list_line(f"{name:<{width}}  ", text) for name, text in titles.items()]
        typer.echo("\n".join([*lines, "", f"in {folder}"]))


def pages_by_name(folder: Path) -> dict[str, Path]:
    """Return the pages by name, sorted within each folder; the README of a folder has the name of the folder."""
    return {
        subfolder if path.stem == "README" else path.stem: path
        for subfolder in FOLDERS
        for path in sorted((folder / subfolder).glob("*.md"))
    }


def folder_of_pages() -> Path:
    """Return the folder of the pages: in a checkout beside the package, else among the installed data files.

    Raises
    ------
    InputError : the pages are in neither folder.
    """
    from importlib.metadata import PackageNotFoundError, files

    checkout = Path(leactl.__file__).parents[1] / "docs"
    if (checkout / KNOWN_PAGE).is_file():
        return checkout
    try:
        installed_pages = [
            Path(str(file.locate())).resolve() for file in files("leactl") or [] if INSTALLED_FOLDER in file.as_posix()
        ]
    except PackageNotFoundError:
        installed_pages = []
    # all pages are in one folder, two levels above KNOWN_PAGE
    folders = {path.parents[1] for path in installed_pages if path.as_posix().endswith(KNOWN_PAGE) and path.is_file()}
    if not folders:
        raise InputError("the pages are not installed; they are the folder docs of the project's source")
    return folders.pop()


def title(path: Path) -> str:
    """Return the title of a page, its first line without `#`."""
    with path.open(encoding="utf-8") as stream:
        return stream.readline().lstrip("# ").rstrip()
