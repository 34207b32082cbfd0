"""Scans: many runs from one plan, solved by workers, and the tables and figures made of them."""
