"""A packing out of dumps of LAMMPS: python read_dumps.py ATOMS CONTACTS FILE, its types 2 and 3 driven

compute pair all property/local patom1 patom2 cutoff radius
compute force all pair/local force
dump atoms all custom 1000 packed.atoms id type x y z radius omegax omegay omegaz
dump contacts all local 1000 packed.contacts c_pair[1] c_pair[2] c_force
"""

import sys

import taichi_bearings as tb

atoms, contacts, file = sys.argv[1:]
columns = ("c_pair[1]", "c_pair[2]", "c_force")
tb.Packing.from_lammps(atoms, contacts, columns, driven_types={2: 0, 3: 1}, seed=3).save(file)
