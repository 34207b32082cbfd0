"""The `bearings` command: parse, call one function, print, exit code. Installed as `taichi_bearings_cli`."""

import time

STARTED = time.perf_counter()  # what Python itself needs before and after, a tenth of a second, is nobody's
