"""The directory of a run: there in full under its name, or not at all."""

import contextlib
import os
import secrets
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from taichi_bearings.errors import FileError
from taichi_bearings.files.checkpoint_file import NAME as CHECKPOINT


@dataclass
class RunDirectory:
    """A run directory that appears under its name only when complete.

    Files are written into a hidden neighbour and renamed at the end, so a killed run leaves nothing half-written; an
    existing directory is replaced only with `force`, and only then.
    """

    path: Path
    force: bool = False

    def __post_init__(self) -> None:
        try:
            self._prepare()
        except OSError as error:
            raise FileError(f"output directory {self.path} cannot be written: {error.strerror or error}") from None

    def _prepare(self) -> None:
        exists = os.path.lexists(self.path)
        if exists and not self.force:
            raise FileError(f"output directory {self.path} already exists; choose another --out or add --force")
        is_run = any((self.path / name).is_file() for name in ("run.h5", CHECKPOINT)) or (
            self.path.is_dir() and not any(self.path.iterdir())
        )
        if exists and not is_run:
            raise FileError(f"{self.path} is not a run directory; --force replaces only run directories")
        self.partial = self.path.with_name(f".{self.path.name}.partial-{os.getpid()}-{secrets.token_hex(3)}")
        self._made = [folder for folder in self.path.parents if not folder.exists()]  # nearest first
        self.partial.mkdir(parents=True)

    def publish(self) -> None:
        """Rename to the final name, replacing an earlier run if that was allowed."""
        if self.path.exists():
            retired = self.partial.with_name(self.partial.name + "-replaced")
            self.path.rename(retired)
            self.partial.rename(self.path)
            shutil.rmtree(retired)
        else:
            self.partial.rename(self.path)

    def discard(self) -> None:
        """Leave nothing behind, not even folders that were made for this run."""
        shutil.rmtree(self.partial, ignore_errors=True)
        for folder in self._made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def default_run_path(command: str = "run") -> Path:
    """outputs/<time>-<command>-<id> below the working folder."""
    return Path("outputs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{command}-{secrets.token_hex(2)}"
