"""A program of commands: its help, which is plain text and ends with examples, and its version."""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Annotated, Any

import typer
from rich.markup import escape
from typer.core import TyperCommand

from shared.cli.ending import Interrupted


class PlainCommand(TyperCommand):
    """A command whose help is plain text: Rich would take a unit in square brackets for markup, and drop it.

    :raises Interrupted: in :meth:`invoke`, which else raises what the command does
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.help = escape(self.help or "")
        for parameter in self.params:
            if isinstance(text := getattr(parameter, "help", None), str):
                parameter.help = escape(text)  # type: ignore[attr-defined]

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            if any("--resume" in parameter.opts for parameter in self.params):
                raise
            raise Interrupted from None


def application(
    program: str, about: str, commands: Sequence[Callable[..., None]], examples: Mapping[str, Sequence[str]]
) -> typer.Typer:
    """The commands of a program, each by its function's name.

    :param program: its package, which has a ``__version__``
    :param about: one line
    :param examples: by a command's name, what its help ends with
    """
    app = typer.Typer(no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False)
    for command in commands:
        name = command.__name__.rstrip("_")
        # Typer joins the lines of a paragraph: each example is one.
        app.command(name, cls=PlainCommand, epilog="\n\n".join(("Examples:", *examples[name])))(command)

    def print_version(wanted: bool) -> None:
        if wanted:
            typer.echo(f"{program} {import_module(program).__version__}")
            raise typer.Exit()

    # Typer reads the annotation, which names a function of this one: in this module annotations are not postponed.
    @app.callback(help=about)
    def options(
        version: Annotated[
            bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print the version and leave.")
        ] = False,
    ) -> None:
        pass

    return app
