"""What can be proven of a contact (states.py), in numbers."""

SLIPLESS, SLIPPING, UNPROVEN, TIED = 0, 1, 2, 4
DRIVEN_STATE = 3  # of a contact that takes no part, in files
