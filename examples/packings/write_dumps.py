"""The frame of packed.atoms and packed.contacts, in the format of LAMMPS: python write_dumps.py FOLDER

No LAMMPS has run: spheres are those of tb.Packing.random, type 2 the floor and 3 the surface, and the spins of both are
imposed. `dump_modify ... format float %20.15g` makes LAMMPS write as many digits.
"""

import sys
from pathlib import Path

import numpy as np

import taichi_bearings as tb

width, folder = 7.0, Path(sys.argv[1])
packing = tb.Packing.random(150, width=width, seed=7, direction=(0, 1, 0))
head = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF {}\n{}\nITEM: BOX BOUNDS pp pp ff\n"
head += f"0 {width}\n0 {width}\n-1 20\nITEM: {{}}\n"
columns = [np.arange(packing.spheres) + 1, packing.driven + 2, packing.center, packing.radius, packing.spin]
with open(folder / "packed.atoms", "w") as file:
    file.write(head.format("ATOMS", packing.spheres, "ATOMS id type x y z radius omegax omegay omegaz"))
    np.savetxt(file, np.column_stack(columns), fmt="%d %d %.15g %.15g %.15g %.15g %.15g %.15g %.15g")
with open(folder / "packed.contacts", "w") as file:
    file.write(head.format("ENTRIES", packing.contacts, "ENTRIES c_pair[1] c_pair[2] c_force"))
    np.savetxt(file, np.column_stack([packing.contact + 1, packing.normal_force]), fmt="%d %d %.15g")
