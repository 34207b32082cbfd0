"""Packings out of files of others: tables, centres alone, and dumps of LAMMPS and LIGGGHTS."""
