"""What quantities are called and counted in on the axes of figures, and what a figure says of its system."""

from taichi_bearings.packing import Packing
from taichi_bearings.quantities import COLUMNS
from taichi_bearings.scene import Scene

SPEED_OF = {True: r"\omega_T", False: r"\omega_B"}


def _spaced(unit: str) -> str:
    """A unit as figures print it; nothing for pure numbers."""
    return "" if unit == "1" else unit.replace("/", " / ").replace("*", " · ")


def describe(scene: Scene | Packing, sample: int | None = 0) -> str:
    """Sizes, law and seed of a sample, or of all, in words for a title; of a packing sizes and law."""
    if isinstance(scene, Packing):
        what = "discs" if scene.dimension == 2 else "spheres"
        return f"{scene.spheres:,} {what}, {str(scene.law).replace('coulomb', 'Coulomb')}"
    shape = r"\times".join(map(str, scene.lattice.shape))
    seed = f"seeds {scene.seeds[0]} to {scene.seeds[-1]}"
    if sample is not None or scene.replicas == 1:
        seed = f"seed {scene.seeds[sample or 0]}"
    return f"${shape}$ {str(scene.law).replace('coulomb', 'Coulomb')}{scene.closed}, {seed}"


def mathematics(value: float, digits: int = 6) -> str:
    """A number to so many digits within mathematics, 5e-12 as a power of ten."""
    mantissa, power, exponent = f"{value:.{digits}g}".partition("e")
    return mantissa + (rf"\times10^{{{int(exponent)}}}" if power else "")


def larger_spin(spin_top: float, spin_bottom: float) -> str:
    """Symbol of the larger imposed spin."""
    return SPEED_OF[abs(spin_top) >= abs(spin_bottom)]


def driving(scene: Scene | Packing) -> tuple[float, str]:
    """The imposed spin that times and powers are counted in, 1/time, and its symbol; of packings 1 and an empty one."""
    if isinstance(scene, Packing):
        return 1.0, ""
    top, bottom = scene.imposed
    return (abs(top), SPEED_OF[True]) if top else (abs(bottom) or 1.0, SPEED_OF[False])


def power_unit(scene: Scene | Packing) -> tuple[float, str]:
    """What powers are counted in, energy/time, and its symbol; 1 and an empty one without friction, or of packings."""
    spin, symbol = driving(scene)
    if isinstance(scene, Packing) or not scene.law.holds:
        return 1.0, ""
    return scene.normal_force * scene.lattice.radius * spin, rf"F_n R\,{symbol}"


def time_label(symbol: str) -> str:
    return rf"time, ${symbol}\,t$" if symbol else "time"


def energy_unit(scene: Scene | Packing) -> tuple[float, str]:
    """What energies are counted in, and its symbol; 1 and an empty one without friction, or of packings."""
    if isinstance(scene, Packing):
        return 1.0, ""
    return (scene.normal_force * scene.lattice.radius, r"F_n R") if scene.law.holds else (1.0, "")


def over(symbol: str, unit: str, without: str) -> str:
    """A quantity over its unit as mathematics. without : the words for the unit where it has no symbol."""
    if not unit:
        return f"${symbol}$ ({without})"
    return rf"${symbol}\,/\,({unit})$" if "R" in unit else rf"${symbol}\,/\,{unit}$"


SYMBOLS = {name: (row.symbol, _spaced(row.unit)) for name, row in COLUMNS.items() if row.symbol}
"""Symbol and unit of the columns of a scan; the others are called by their names."""


def as_text(words: object) -> str:
    """Words from a file as a figure shows them: a dollar sign in them begins no mathematics."""
    return str(words).replace("$", r"\$")


def column_label(name: str) -> str:
    """A column of a scan, or the means of one over another, on an axis."""
    parts = name.split("/")
    if not all(part in SYMBOLS for part in parts):
        return as_text(name)
    symbols, units = zip(*(SYMBOLS[part] for part in parts), strict=True)
    if len(parts) == 1:
        unit = f" ({units[0]})" if units[0] else ""
        return f"${symbols[0]}${unit}"
    above, below = (f"({unit})" if " " in unit else unit or "1" for unit in units)
    unit = "" if above == below else f" ({above} / {below})"
    return rf"$\langle {symbols[0]} \rangle\,/\,\langle {symbols[1]} \rangle${unit}"
