"""The `bearings` command: reads options, calls one function, prints, exits. Installed as `taichi_bearings_cli`."""

import time

STARTED = time.perf_counter()  # the start of all times that are reported, a tenth of a second after that of Python
