"""Taichi kernels: the physics of a contact is stated once, and applied to all spheres of a flat array.

They know no options and no files, and of time only the steps that are made in one launch.

Words that the arguments share. A *site* is the place of a sphere, with the contacts to its upper neighbours. A *row* is
one number of every site; `values` is the flat array of all rows, and the number of site s in row n stands at n * row +
s, where `row` is the distance from one row to the next. A *block* is a group of sites that are neighbours in memory
and are worked on together: 16 on a CPU, where a SIMD instruction takes several, and 1 on a GPU. `first` is the index of
the first site of a block.
"""
