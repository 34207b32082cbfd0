"""The `bearings` command: parse, call one function, print, exit code. Installed as `taichi_bearings_cli`."""
