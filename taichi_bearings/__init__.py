"""Frustrated bearings on square and cubic lattices, solved on CPU and GPU, with proven error bounds."""

from taichi_bearings.errors import BearingsError, DeviceError, FileError, InputError
from taichi_bearings.version import VERSION

__version__ = VERSION
__all__ = ["BearingsError", "DeviceError", "FileError", "InputError", "__version__"]
