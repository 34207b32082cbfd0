"""Taichi kernels: the physics of a contact stated once and walked over all sites of a flat array.

They know no options and no files, and of time only the steps that are made in one launch.

A *row* is one number of every site. `row` as an argument is the distance from one row to the next, `first` the index of
the first site of a block, and `values` the array that holds all rows.
"""
