"""A packing out of dumps of LAMMPS: python read_dumps.py ATOMS CONTACTS FILE

Its atoms of type 2 are driven to rest and those of type 3 about y. sheared.in makes such dumps; both computes need the
cutoff radius, or LAMMPS finds different numbers of contacts.
"""

import sys

import taichi_bearings as tb

atoms, contacts, file = sys.argv[1:]
columns = ("c_pair[1]", "c_pair[2]", "c_force")
spin = {0: (0, 0, 0), 1: (0, 1, 0)}
tb.Packing.from_lammps(atoms, contacts, columns, driven_types={2: 0, 3: 1}, spin=spin, seed=3).save(file)
