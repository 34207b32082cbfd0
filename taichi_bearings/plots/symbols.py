"""What quantities are called and counted in on the axes of figures, and what a figure says of its system."""

from taichi_bearings.scene import Scene

SPEED_OF = {True: r"\omega_T", False: r"\omega_B"}
POWER_UNIT = r"F_n R\,\omega_T"


def describe(scene: Scene, sample: int | None = 0) -> str:
    """Sizes, law and seed of a sample, or of all, in words for a title."""
    shape = r"\times".join(map(str, scene.lattice.shape))
    seed = f"seeds {scene.seeds[0]} to {scene.seeds[-1]}"
    if sample is not None or scene.replicas == 1:
        seed = f"seed {scene.seeds[sample or 0]}"
    return f"${shape}$ {str(scene.law).replace('coulomb', 'Coulomb')}, {seed}"


def larger_spin(spin_top: float, spin_bottom: float) -> str:
    """Symbol of the larger imposed spin."""
    return SPEED_OF[abs(spin_top) >= abs(spin_bottom)]


def driving(scene: Scene) -> tuple[float, str]:
    """The imposed spin that times and powers are counted in, 1/time, and its symbol."""
    return (abs(scene.spin_top), SPEED_OF[True]) if scene.spin_top else (abs(scene.spin_bottom) or 1.0, SPEED_OF[False])


def power_unit(scene: Scene) -> tuple[float, str]:
    """What powers are counted in, energy/time, and its symbol; 1 and an empty one without friction."""
    spin, symbol = driving(scene)
    if not scene.law.holds:
        return 1.0, ""
    return scene.normal_force * scene.lattice.radius * spin, rf"F_n R\,{symbol}"


def energy_unit(scene: Scene) -> tuple[float, str]:
    """What energies are counted in, and its symbol; 1 and an empty one without friction."""
    return (scene.normal_force * scene.lattice.radius, r"F_n R") if scene.law.holds else (1.0, "")


def over(symbol: str, unit: str, without: str) -> str:
    """A quantity over its unit as mathematics. without : the words for the unit where it has no symbol."""
    if not unit:
        return f"${symbol}$ ({without})"
    return rf"${symbol}\,/\,({unit})$" if "R" in unit else rf"${symbol}\,/\,{unit}$"


SYMBOLS: dict[str, tuple[str, str]] = {
    "L": ("L", ""),
    "power": ("P", "energy / time"),
    "lower_bound": (r"P_\mathrm{low}", "energy / time"),
    "power_minimum_cut": (r"P_\mathrm{cut}", "energy / time"),
    "power_over_cut": (r"P\,/\,P_\mathrm{cut}", ""),
    "power_normalised": (rf"P\,/\,({POWER_UNIT})", ""),
    "next_cut_over_cut": (r"P_\mathrm{cut,2}\,/\,P_\mathrm{cut}", ""),
    "gap": (r"(P - P_\mathrm{low})\,/\,P", ""),
    "spin_top": (r"\omega_T", "1 / time"),
    "spin_bottom": (r"\omega_B", "1 / time"),
    "normal_force": ("F_n", "force"),
    "radius": ("R", "length"),
    "stiffness": ("K_t", "force / length"),
    "damping": ("A_t", "force · time / length"),
    "slipping": (r"N_\mathrm{slipping}", ""),
    "slipless": (r"N_\mathrm{slipless}", ""),
    "slipless_fraction": (r"N_\mathrm{slipless}\,/\,N_\mathrm{contacts}", ""),
    "contacts": (r"N_\mathrm{contacts}", ""),
    "cut_contacts": (r"N_\mathrm{cut}", ""),
    "domains": (r"N_\mathrm{domains}", ""),
    "disjoint_paths": (r"N_\mathrm{paths}", ""),
    "shortest_path": (r"\ell_\mathrm{min}", "contacts"),
    "mean_distance": (r"\langle \ell \rangle", "contacts"),
    "seconds": (r"t_\mathrm{solve}", "s"),
    "slip_threshold": (r"v_\mathrm{slip}", "length / time"),
}
"""Symbol and unit of the columns of a scan; the others are called by their names."""


def column_label(name: str, exponent: float = 0.0) -> str:
    """A column of a scan, or the means of one over another, times a power of L, on an axis."""
    parts = name.split("/")
    scale = "" if exponent == 0 else rf"\; L^{{{exponent:g}}}"
    if not all(part in SYMBOLS for part in parts):
        return f"{name} · ${scale}$" if scale else name
    symbols, units = zip(*(SYMBOLS[part] for part in parts), strict=True)
    if len(parts) == 1:
        unit = f" ({units[0]})" if units[0] else ""
        return f"${symbols[0]}{scale}${unit}"
    unit = (
        ""
        if len(set(units)) == 1
        else " ({} / {})".format(*(f"({unit})" if " " in unit else unit or 1 for unit in units))
    )
    return rf"$\langle {symbols[0]} \rangle\,/\,\langle {symbols[1]} \rangle{scale}${unit}"
