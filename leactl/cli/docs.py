"""`leactl docs`: the pages that come with the program, listed and printed."""

import json
from pathlib import Path

import typer

import leactl
from leactl.cli.helptext import examples, single_command
from leactl.errors import InputError

app = single_command()

INSTALLED = "share/doc/leactl"  # below the environment, as pyproject.toml has it
FOLDERS = ("tutorial", "how-to", "reference", "explanation", "evidence")
LANDMARK = "reference/run-format.md"  # a page that tells the folder of pages from another folder


def pages(incomplete: str) -> list[str]:
    """Names of the pages, for shell completion."""
    return [name for name in pages_by_name(folder_of_pages()) if name.startswith(incomplete)]


@app.command(epilog=examples("docs", "docs safety"))
def docs(
    page: str = typer.Argument("", help="Print this page; without one all are listed.", autocompletion=pages),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout."),
) -> None:
    """List the pages of the manual and where they lie, or print one."""
    from leactl.report.terminal import list_line

    folder = folder_of_pages()
    paths = pages_by_name(folder)
    titles = {name: title(path) for name, path in paths.items()}
    if page and page not in titles:
        raise InputError(f"there is no page {page!r}; there are {', '.join(titles)}")
    if as_json:
        text = {"text": paths[page].read_text(encoding="utf-8")} if page else {}
        typer.echo(json.dumps({"folder": str(folder), "pages": titles, **text}))
    elif page:
        typer.echo(paths[page].read_text(encoding="utf-8"), nl=False)
    else:
        width = max(map(len, titles))
        lines = [list_line(f"{name:<{width}}  ", text) for name, text in titles.items()]
        typer.echo("\n".join([*lines, "", f"in {folder}"]))


def pages_by_name(folder: Path) -> dict[str, Path]:
    """Return the pages by name, sorted within each kind; the index page of a kind has the name of the kind."""
    return {
        kind if path.stem == "README" else path.stem: path
        for kind in FOLDERS
        for path in sorted((folder / kind).glob("*.md"))
    }


def folder_of_pages() -> Path:
    """Return the folder of the pages: in a checkout beside the package, else in the installed data files.

    Raises
    ------
    InputError : they are in neither place.
    """
    from importlib.metadata import PackageNotFoundError, files

    checkout = Path(leactl.__file__).parents[1] / "docs"
    if (checkout / LANDMARK).is_file():
        return checkout
    try:
        installed = [
            Path(str(file.locate())).resolve() for file in files("leactl") or [] if INSTALLED in file.as_posix()
        ]
    except PackageNotFoundError:
        installed = []
    folders = {path.parents[1] for path in installed if path.as_posix().endswith(LANDMARK) and path.is_file()}
    if not folders:
        raise InputError("the pages are not installed; they are the folder docs of the project's source")
    return folders.pop()


def title(path: Path) -> str:
    """Return the title of a page, its first line without `#`."""
    with path.open(encoding="utf-8") as stream:
        return stream.readline().lstrip("# ").rstrip()
