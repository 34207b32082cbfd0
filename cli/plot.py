"""bearings plot"""

from pathlib import Path

import click

KINDS = ("spins", "power", "history", "energy")


@click.command()
@click.argument("kind", type=click.Choice(KINDS), metavar="|".join(KINDS))
@click.argument("run", metavar="RUN")
@click.option("--replica", type=click.IntRange(0), default=0, help="Which replica of a block of seeds.")
@click.option("--time", type=float, default=None, help="spins: the snapshot nearest to this simulated time.")
@click.option("--out", metavar="FILE", default=None, help="PNG, PDF or SVG. [default: KIND.png in the run directory]")
@click.option("--force", is_flag=True, help="Replace an existing file.")
def command(kind: str, run: str, replica: int, time: float | None, out: str | None, force: bool) -> None:
    """Draw one figure from RUN, a run directory or its run.h5.

    \b
    spins    the spins as colour; 3D: from outside and two cuts
    power    where the power is dissipated
    history  power, lower bound and gap as the run went on
    energy   a dynamics: energy injected, dissipated, kinetic, in springs, and what the books miss

    \b
    Example:
      bearings plot spins outputs/my-run --out spins.png
    """
    from taichi_bearings.errors import FileError, InputError
    from taichi_bearings.files.run_file import read_run_file
    from taichi_bearings.plots.energy import draw_energy
    from taichi_bearings.plots.history import draw_history
    from taichi_bearings.plots.power import draw_power
    from taichi_bearings.plots.spins import draw_spins
    from taichi_bearings.plots.style import save

    stored = read_run_file(Path(run))
    if replica >= len(stored.spin):
        raise InputError(f"replica is {replica}; {run} has {len(stored.spin)}, counted from 0")
    path = Path(out) if out else stored.path.parent / f"{kind}.png"
    if path.suffix not in (".png", ".pdf", ".svg"):
        raise InputError(f"out is {str(path)!r}; it must end in .png, .pdf or .svg")
    if path.exists() and not (force or out is None):
        raise FileError(f"{path} already exists; choose another --out or add --force")
    if kind == "spins":
        figure = draw_spins(stored if time is None else stored.at_time(time), replica)
    elif kind == "power":
        figure = draw_power(stored, replica)
    elif kind == "energy":
        figure = draw_energy(stored, replica)
    else:
        figure = draw_history(stored)
    try:
        save(figure, path)
    except OSError as error:
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from None
    click.echo(path)
