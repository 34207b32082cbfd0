"""The command `bearings list`."""

import json
from pathlib import Path

import click
from taichi_bearings_cli.options import FILES, json_option


@click.command()
@click.argument("folder", metavar="[DIR]", type=FILES, default="outputs")
@json_option
def command(folder: str, as_json: bool) -> None:
    """List runs and scans in DIR [default: outputs], newest first: what they hold, how they ended and when.

    Only summaries and journals are read, so the list says what these say; `bearings verify` checks a run. A folder that
    cannot be read is named with the reason.

    \b
    Examples:
      bearings list
      bearings list outputs --json
    """
    import time

    from taichi_bearings.errors import BearingsError
    from taichi_bearings.scans.listing import entries
    from taichi_bearings.words import counted

    found = entries(Path(folder))
    if as_json:
        click.echo(json.dumps({"folder": folder, "entries": [entry.as_dict() for entry in found]}, allow_nan=False))
        return
    widest = max((len(Path(entry.path).name) for entry in found), default=0)
    for entry in found:
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.modified))
        line = f"{when}  {entry.kind:4}  {Path(entry.path).name:{min(widest, 40)}}  {entry.words()}"
        click.echo(BearingsError(line))  # a line, whatever the names hold
    runs, scans = (sum(entry.kind == kind for entry in found) for kind in ("run", "scan"))
    click.echo(f"{counted(runs, 'run')} and {counted(scans, 'scan')} in {folder}", err=True)
