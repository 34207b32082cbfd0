"""The `bearings` command: reads options, calls one function, prints, exits. Installed as `taichi_bearings_cli`."""

import time

STARTED = time.perf_counter()  # when times begin; a tenth of a second that Python needs before is not counted
