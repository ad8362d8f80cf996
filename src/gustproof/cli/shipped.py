"""The commands `list` and `show` of laws, vehicles, designs and scenarios."""

from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from firmware_model.config.validation import did_you_mean, none_of
from gustproof.cli.options import AsJson, complete, print_json


class WithDefault(TyperGroup):
    """Group of commands of which the first does not need its name: what names no other one is for it.

    Options that it lacks name the first one that has them all.
    """

    @property
    def default(self) -> str:
        """Name of the command that does not need it."""
        return next(iter(self.commands))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the name of the command that is meant before its arguments."""
        alone = ctx.resilient_parsing or self.no_args_is_help
        if args[0] in (*self.commands, "--help", "-h") if args else alone:
            return super().parse_args(ctx, args)
        another = len(args) > 1 and not (args[0].startswith("-") or args[1].startswith("-"))
        if another and "." not in args[0] and did_you_mean(args[0], self.commands):
            ctx.fail(none_of(args[0], list(self.commands)))  # a mistyped name, with the argument of that command
        return super().parse_args(ctx, [self.find_meant(args), *args])

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Complete to the names of the modes, and to the options of the one that does not need its name."""
        default = self.commands[self.default]
        alone = default.make_context(self.default, [], parent=ctx, resilient_parsing=True)
        return [*super().shell_complete(ctx, incomplete), *default.shell_complete(alone, incomplete)]

    def find_meant(self, args: list[str]) -> str:
        """Return the name of the command that arguments are for."""
        modes = {name: {each for p in mode.params for each in p.opts} for name, mode in self.commands.items()}
        given = {word.partition("=")[0] for word in args} & set().union(*modes.values())
        return next((name for name, own in modes.items() if given <= own), self.default)


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
        from gustproof.show.report.catalogue import CATALOGUES, catalogue_table, summarize_all

        if as_json:
            print_json(summarize_all(CATALOGUES[kind]))
            return
        from gustproof.show.report.terminal import show

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
        from gustproof.show.report.catalogue import CATALOGUES, read_source, render_law, to_document
        from gustproof.show.report.terminal import show

        catalogue = CATALOGUES[kind]
        if as_json:
            print_json(to_document(catalogue, name))
        elif kind == "law":
            show(render_law(catalogue.load(name)))
        else:
            print(read_source(catalogue, name), end="")
