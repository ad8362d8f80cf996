"""The command `gustproof guide`: the guide as a site, and the schemas of the files."""

import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.options import working


def guide(
    context: typer.Context,
    page: Annotated[str, typer.Argument(help="Page to open: tutorial, px4, keys-scenario, api, …")] = "index",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the site to this folder [default: a temporary one]."),
    ] = None,
    browse: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
    schemas: Annotated[
        Path | None,
        typer.Option(help="Write the JSON Schemas of all TOML files to this folder, and nothing else."),
    ] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(help="Fly and draw the guide's pictures into this folder, and nothing else."),
    ] = None,
) -> None:
    """Write the guide as HTML pages that need no network, and open one in the browser.

        gustproof guide

        gustproof guide tutorial

        gustproof guide -o site --no-open

    An editor that knows TOML completes and checks the keys of scenario, vehicle and design files by their schemas.

        gustproof guide --schemas schemas
    """
    if schemas is not None:
        from gustproof.guide.schemas import write_schemas

        print("\n".join(map(str, write_schemas(schemas))))
        return
    if pictures is not None:
        from gustproof.guide.drawings import draw_pictures

        with working(f"drawing {pictures}", quiet=False):
            drawn = draw_pictures(pictures)
        print("\n".join(map(str, drawn)))
        return
    from tempfile import mkdtemp

    from gustproof.guide.site import load_pages, page_names, write_site

    if page not in page_names():
        raise ConfigError(f"no page named '{page}', there are {', '.join(page_names())}")
    if output is not None and output.is_dir() and any(output.iterdir()) and not (output / "guide.css").exists():
        raise ConfigError(f"{output}: holds other files, and no guide to replace")
    folder = Path(mkdtemp(prefix="gustproof-guide-")) if output is None else output
    with working(f"writing {folder}", quiet=False):
        write_site(load_pages(options_page(context.find_root())), folder)
    opened = (folder / f"{page}.html").resolve()
    print(opened)
    if browse:
        webbrowser.open(opened.as_uri())


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
    for part, each in parts.items():
        yield from _iter_commands(each, f"{name} {part}")
