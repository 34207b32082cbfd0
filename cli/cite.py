"""The command `bearings cite`."""

import click
from taichi_bearings_cli.options import Choice


@click.command()
@click.option(
    "--format",
    "form",
    type=Choice(["bibtex", "cff"]),
    default="bibtex",
    help="Format of the citation; cff is the Citation File Format. [default: bibtex]",
)
def command(form: str) -> None:
    """Print how to cite the program, and the paper whose systems it solves.

    \b
    Examples:
      bearings cite >> my-thesis.bib
      bearings cite --format cff
    """
    from taichi_bearings.citation import bibtex, cff

    click.echo(cff() if form == "cff" else bibtex(cff()), nl=False)
