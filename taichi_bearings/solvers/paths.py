"""`Paths`, the central paths of all samples of a scene, with what a checkpoint keeps of them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from taichi_bearings.conic.descent import Descent
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.resolution import Resolved
from taichi_bearings.solvers.part import Part

OF_A_POINT = ("spins", "bound", "difference", "dual")  # fields of an iterate that change along the path
FIELDS = ("spins", "difference", "dual", "slipping", "at_limit", "heads", "rest")
OF_A_MINIMUM = {name: name for name in FIELDS} | {"tied": "sometimes_slips"}
"""By name in checkpoints, the fields of a settled minimum that are arrays, or None."""


class Paths(Descent, Part):
    """The samples of a scene on their central paths, curves of spins and forces that end at the minimum: the solver of
    the interior-point method. One iteration is a Newton step of every sample that is not yet done.
    """

    @property
    def iteration(self) -> int:  # type: ignore[override]
        """Number of Newton steps of the sample that has made the most."""
        return max((sample.steps for sample in self.samples), default=0)

    def state(self) -> dict[str, np.ndarray]:
        """Return by name all that the further iterations depend on, for a checkpoint:

        * "iteration": number of iterations made;
        * "n/now/..." and "n/before/...", of sample number n: the arrays OF_A_POINT of its point on the path, and of
          the point before it;
        * "n/path": its Newton steps, its gap, and as 0 or 1 whether it is done, is at its end, and so on;
        * "n/settled/...": the arrays OF_A_MINIMUM of its minimum, if its contact states are settled.
        """
        found = {"iteration": np.array(self.iteration)}
        for number, sample in enumerate(self.samples):
            for place, point in (("now", sample.iterate), ("before", sample.before or sample.iterate)):
                found |= {f"{number}/{place}/{name}": getattr(point, name) for name in OF_A_POINT}
            has = sample.before is not None, sample.resolved is not None
            flags = (sample.steps, sample.gap, sample.done, sample.at_end, sample.tried, *has)
            found[f"{number}/path"] = np.array(flags, dtype=float)
            if (settled := sample.resolved) is not None:
                arrays = {
                    name: of for name, field in OF_A_MINIMUM.items() if (of := getattr(settled, field)) is not None
                }
                arrays["borne"] = np.array(settled.borne)
                for name, of in arrays.items():
                    found[f"{number}/settled/{name}"] = of.astype(np.uint8) if of.dtype == bool else of
        return found

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the arrays by name that `state` returned in an earlier call; raise ValueError if they do not
        fit these paths.
        """
        for number, sample in enumerate(self.samples):
            points: list[Any] = [
                {name: np.array(state[f"{number}/{place}/{name}"]) for name in OF_A_POINT}
                for place in ("now", "before")
            ]
            now, before = (replace(sample.iterate, **point) for point in points)
            steps, gap, done, at_end, tried, has_before, is_settled = state[f"{number}/path"].tolist()
            sample.iterate, sample.before = now, before if has_before else None
            sample.steps, sample.gap, sample.tried = int(steps), gap, tried
            sample.done, sample.at_end = bool(done), bool(at_end)
            sample.resolved = _settled(state, number, now) if is_settled else None


def _settled(state: Mapping[str, np.ndarray], number: int, now: Iterate) -> Resolved:
    """Return the minimum of a sample with settled contact states (spins, forces, and which contacts slip) from the
    arrays of a checkpoint; raise ValueError if their types or shapes do not fit.

    state : all arrays of the checkpoint, by name.
    number : number of the sample.
    now : its point on the path.
    """
    begin = f"{number}/settled/"
    given: dict[str, Any] = {n: np.array(state[begin + n]) for n in OF_A_MINIMUM if begin + n in state}
    likes = {"spins": now.spins, "rest": now.spins, "difference": now.difference, "dual": now.dual}
    for name, values in given.items():
        is_mask = name not in likes
        like = now.friction if name in ("slipping", "at_limit", "tied") else likes.get(name, now.spins)
        if values.shape != like.shape or values.dtype.kind != ("u" if is_mask else "f"):
            raise ValueError(f"the array {name} has the wrong type, {values.dtype}, or shape, {values.shape}")
        given[name] = values.astype(bool) if is_mask else values
    fields = {OF_A_MINIMUM[name]: values for name, values in given.items()}
    return Resolved(**fields, borne=bool(state[begin + "borne"]), viscosity=now.viscosity)
