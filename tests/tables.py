"""Tables that were written, read back."""

import csv


def rows_of(path):
    """The rows of a CSV file as texts by column, without the notes above them."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))
