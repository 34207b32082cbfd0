"""A law and a method of a user's own, with an option and checkpoints: bounded friction, and an accelerated gradient.

Its import adds both to the tables. `journey` solves, stores, resumes and verifies.
"""

from dataclasses import dataclass

import numpy as np

import taichi_bearings as tb
from taichi_bearings.errors import FileError
from taichi_bearings.kernels.contact import FORCES
from taichi_bearings.options import TRUTH, how
from taichi_bearings.runs.run import resume, run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene.law import LAWS, Quantity
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers.method import Method
from taichi_bearings.solvers.table import MethodOptions, register
from tests.own_laws import Bounded, bounded_force


class Capped(Bounded):
    """Defined here, in the file that adds it to the table, so that other processes add it too."""


LAWS["bounded"] = Capped("bounded", (Quantity("friction", "force"),), minimises="potential")
FORCES["bounded"] = bounded_force


@register
@dataclass(frozen=True, kw_only=True)
class Accelerated(MethodOptions):
    """Nesterov's accelerated gradient for any law whose force has a finite slope."""

    name = "accelerated"
    implementation = "tests.agreement.own:AcceleratedGradient"
    needs_taichi = False
    keeps_checkpoints = True

    restart: bool = how(True, TRUTH, "Forget the momentum now and then.")

    @staticmethod
    def solves(law):
        return law.has_viscosity and not law.has_friction


class AcceleratedGradient(Method):
    """With the step of the steepest contacts; the momentum is forgotten every 500 iterations if `restart`."""

    resumes = True

    def begin(self, scene, spin):
        super().begin(scene, spin)
        self.iteration = self.age = 0
        self.spins = scene.staggered_spin(spin, self.spin_axes)
        self.ahead = self.spins.copy()
        fastest = 3 * scene.lattice.radius * float(np.abs(self.spins).max())
        self.step = 1 / (24 * scene.lattice.radius * scene.steepest(fastest).max())

    def next_check(self, iteration):
        return iteration + 100

    def forces(self, spins):
        difference = self.differences(spins)
        length = vector_length(difference)
        size = self.scene.law.force(self.scene.material, self.scene.lattice.radius * length)
        return difference * np.divide(size, length, out=np.zeros_like(size), where=length > 0)

    def advance(self, steps):
        for _ in range(steps):
            new = self.ahead.copy()
            new[..., 1:-1] += self.step * self.pulls(self.forces(self.ahead))[..., 1:-1]
            self.age = 0 if self.options.restart and self.age == 500 else self.age + 1
            self.ahead = new + self.age / (self.age + 3) * (new - self.spins)
            self.spins = new
            self.iteration += 1

    def progress(self):
        return self.judged(self.spins, self.forces(self.spins), iteration=self.iteration, resolution=0.0)

    def state(self):
        return {"numbers": np.array([self.iteration, self.age]), "spins": self.spins, "ahead": self.ahead}

    def restore(self, state):
        self.iteration, self.age = state["numbers"].tolist()
        self.spins, self.ahead = state["spins"].copy(), state["ahead"].copy()


CASES = [("bounded", "accelerated"), ("bounded", "gradient-descent"), ("viscous", "accelerated"),
         ("viscous", "gradient-descent"), ("viscous", "auto")]  # fmt: skip


def journey(folder, law, method):
    """What is found on the way, by name."""
    scene = tb.Scene.random((4, 5), seed=3, law=law)
    whole = tb.solve(scene, method, tolerance=1e-7, threads=1)
    many = [one.power for one in tb.solve_many([scene, scene], method, tolerance=1e-7, workers=1)]
    path = folder / f"{law}-{method}"
    asked = RunSettings(shape=(4, 5), seed=3, law=law, method=method, tolerance=1e-7, threads=1, figures="none")
    if method == "auto":
        found = run(asked, path)
    else:
        stop = {"iterations": 10, "checkpoint_every": 1e-9}
        early = run(RunSettings(**{**asked.given, **stop}), path)
        assert early.status == "step-limit", early.status
        found = resume(path, {"iterations": 100_000})
    try:
        verified = verify(path)["verified"]
    except FileError as error:
        verified = str(error)
    again = tb.load(path)
    return {
        "path": str(path), "power": whole.power, "status": whole.status, "many": many, "resumed": found.power,
        "loaded": again.power, "kept": "restart" in (path / "scene.toml").read_text(), "verified": verified,
    }  # fmt: skip
