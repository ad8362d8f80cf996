"""The command `gustproof guide`: the guide as a site, and the schemas of the files."""

import os
import shutil
import webbrowser
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import mkdtemp
from typing import Annotated, Any

import typer

from firmware_model.config.validation import did_you_mean, sanitize_line
from firmware_model.errors import ConfigError
from gustproof.cli.options import Force, check_folder_output, check_output, check_parent, working


def guide(
    context: typer.Context,
    page: Annotated[str, typer.Argument(help="Page to open: tutorial, px4, keys-scenario, api, …")] = "index",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the site to this folder [default: one in the cache]."),
    ] = None,
    browse: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
    schemas: Annotated[
        Path | None,
        typer.Option(help="Write the JSON Schemas of TOML files and of JSON output to this folder, and nothing else."),
    ] = None,
    examples: Annotated[
        Path | None,
        typer.Option(help="Write notebooks and controllers to this folder, and nothing else."),
    ] = None,
    force: Force = False,
) -> None:
    """Write the guide as HTML pages that need no network, and open one in the browser.

        gustproof guide

        gustproof guide tutorial

        gustproof guide -o site --no-open

    An editor that knows TOML completes and checks the keys of scenario, vehicle and design files by their schemas.

        gustproof guide --schemas schemas

        jupyter lab $(gustproof guide --examples examples)
    """
    if schemas is not None:
        from gustproof.guide.schema_files import schema_files, write_schemas

        _check_files(schemas, schema_files(schemas))
        print("\n".join(map(str, write_schemas(schemas))))
        return
    if examples is not None:
        from gustproof.guide.notebooks import example_files, write_examples

        _check_files(examples, example_files(examples))
        write_examples(examples)
        print(examples)
        return
    from gustproof.guide.site import load_pages, page_names, write_site

    page = page.removesuffix(".md")
    if page not in page_names():
        near = did_you_mean(page, page_names()) or f", there are {', '.join(page_names())}"
        raise ConfigError(f"no page named '{sanitize_line(page)}'{near}")
    if output is not None:
        check_folder_output(output)
    folder = output or _own_folder()
    with working(f"writing {folder}", quiet=False):
        write_site(load_pages(options_page(context.find_root())), folder)
    opened = (folder / f"{page}.html").resolve()
    print(opened)
    if browse:
        webbrowser.open(opened.as_uri())


def _check_files(folder: Path, paths: Iterable[Path]) -> None:
    """Refuse files in a folder that can't be made, or that exist, unless `Force` is given."""
    check_parent(folder)
    for path in paths if folder.exists() else ():
        check_output(path, path.suffix, "this file")


def _own_folder() -> Path:
    """Return a place for the site in the user's cache, empty; a temporary folder where that can't be written."""
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gustproof"
        cache.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # no home
        return Path(mkdtemp(prefix="gustproof-guide-"))
    shutil.rmtree(cache / "guide", ignore_errors=True)
    return cache / "guide" if os.access(cache, os.W_OK) else Path(mkdtemp(prefix="gustproof-guide-"))


def options_page(root: Any) -> str:
    """Return the reference of all commands below the root's context."""
    from gustproof.guide.reference import command_options

    commands = dict(_iter_commands(root.command, "gustproof"))
    return command_options(commands, lambda name, command: type(root)(command, info_name=name))


def _iter_commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield each command with its full name, those of groups in place of the group."""
    parts = getattr(command, "commands", None)
    if parts is None:
        yield name, command
        return
    for part in command.list_commands(None):
        each = parts[part]
        yield from _iter_commands(each, f"{name} {part}")
