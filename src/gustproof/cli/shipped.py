"""The commands `list` and `show` of laws, vehicles, designs and scenarios."""

from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from gustproof.cli.options import AsJson, complete, print_json


class WithDefault(TyperGroup):
    """Group of commands of which one does not need its name: any first word that is no other command's is its own."""

    default = "solve"

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the name of the default command before its arguments."""
        return super().parse_args(ctx, args if args and args[0] in self.commands else [self.default, *args])


def add_catalogue(group: typer.Typer, kind: str) -> None:
    """Add the commands that list and show what is shipped of a kind."""
    several, ending = f"{kind}s", ".json" if kind == "law" else ".toml"
    listing = f"List the shipped {several}, with the subject of each.\n\ngustproof {kind} list"
    example = {"law": "flagship", "vehicle": "iris > mine.toml", "design": "D1 > mine.toml"}.get(
        kind, "paper > mine.toml"
    )
    text = "the facts of a law, and what it was made with" if kind == "law" else f"the file of a {kind}"
    use = "" if kind == "law" else ", to read or to start your own from"
    showing = f"Print {text}{use}.\n\ngustproof {kind} show {example}"

    @group.command("list", help=listing)
    def list_all(as_json: AsJson = False) -> None:
        from gustproof.report.catalogue import CATALOGUES, catalogue_table, summarize_all

        if as_json:
            print_json(summarize_all(CATALOGUES[kind]))
            return
        from gustproof.report.terminal import show

        show(catalogue_table(CATALOGUES[kind]))

    @group.command("show", help=showing)
    def show_one(
        name: Annotated[
            str,
            typer.Argument(
                help=f"Name of a shipped {kind}, or a {ending} file.",
                show_default=False,
                autocompletion=complete(kind),
            ),
        ],
        as_json: AsJson = False,
    ) -> None:
        from gustproof.report.catalogue import CATALOGUES, read_source, render_law, to_document
        from gustproof.report.terminal import show

        catalogue = CATALOGUES[kind]
        if as_json:
            print_json(to_document(catalogue, name))
        elif kind == "law":
            show(render_law(catalogue.load(name)))
        else:
            print(read_source(catalogue, name), end="")
