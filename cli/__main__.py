"""python -m taichi_bearings_cli"""

from taichi_bearings_cli.main import main

if __name__ == "__main__":
    main()
