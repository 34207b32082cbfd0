"""Samples of a packing that are stepped together: each has a method of its own, but one call of a kernel steps all.

Every sample has its own constants, its own looks (when its progress is read) and its own end, so its result has the
same bits as if it were solved alone. Stepping several at a time only saves calls of kernels, which on a GPU take longer
than the steps of a small packing.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import Fields
from taichi_bearings.scene import Bearing
from taichi_bearings.solvers.contacts import Launch
from taichi_bearings.solvers.method import Method, Swept
from taichi_bearings.solvers.on_lists import NOTHING, OnLists, team_of

# spheres of all samples that are stepped together: on a CPU so few that its caches hold their numbers
MOST_ON_CPU, MOST_ON_GPU = 4_000, 4_000_000


def samples_at_once(scene: Bearing) -> int:
    """Return how many samples of a packing to step at a time: as many as keep a GPU busy, or as fit into the caches of
    a CPU.

    scene : the packing, with all its samples.
    """
    most = MOST_ON_GPU if runtime.current().is_gpu else MOST_ON_CPU
    return max(1, min(scene.replicas, most // max(scene.network.spheres, 1)))


class Together:
    """Methods that solve one sample of a packing each, and that advance by the same numbers of steps.

    going : the methods that have not ended.
    joined : the methods whose fields lie in one memory, so that one call of a kernel steps them all. If the samples
        have different contacts, or a method does not use such kernels, it is empty, and each method is advanced alone.
    fields, team, sweeps : the common fields, and the threads and the kernel for them.
    """

    def __init__(self, methods: Sequence[Method]) -> None:
        """Join the fields of the methods if their samples have the same contacts and all step by sweeps.

        methods : methods whose `begin` was called, each with one sample.
        """
        self.going = list(methods)
        self.joined = [
            method for method in methods if isinstance(method, Swept) and isinstance(method.contacts, OnLists)
        ]
        alike = len(self.joined) == len(methods) > 1
        tables = [_contacts(method).lists.measures for method in self.joined]
        if alike and all(np.array_equal(tables[0], other) for other in tables[1:]):
            self._join()
        else:
            self.joined = []

    def _join(self) -> None:
        """Copy the fields (numbers of spheres and contacts) of all methods in `joined` into one memory, one sample
        after the other, so that one call of a kernel steps them all.
        """
        first = _contacts(self.joined[0])
        self.fields = Fields(first.lists.several(len(self.joined)), first.spec)
        for number, method in enumerate(self.joined):
            part, contacts = self.fields.part(number), _contacts(method)
            for name in part.names:
                part.load(name, contacts.fields.read(name))
            contacts.fields = part
        self.team, self.sweeps = team_of(self.fields, first.spec), self.joined[0].sweeps

    def advance(self, steps: int) -> None:
        """Let each method make `steps` steps.

        Each method plans its launches (repeated calls of the kernel with the same constants). The kernel is called for
        all methods at once, as often as the shortest launch asks; then each method continues with the rest of its
        launch, or with its next one.
        """
        if not self.joined:
            for method in self.going:
                method.advance(steps)
            return
        plans = [(_contacts(method), method.launches(steps)) for method in self.joined if method in self.going]
        launches = [next(plan, None) for _, plan in plans]
        while calls := min((launch.calls for launch in launches if launch is not None), default=0):
            for (contacts, _), launch in zip(plans, launches, strict=True):
                if launch is not None:
                    contacts.load_numbers(launch)
            self.sweeps.run(self.fields, self.team, calls, NOTHING)
            launches = [_rest_of_plan(launch, calls, plan) for launch, (_, plan) in zip(launches, plans, strict=True)]

    def drop(self, ended: Method) -> None:
        """Take out a method that has ended. Its fields stay in the common memory and are stepped with the others,
        without any effect on them, until half of the methods have ended; then they are removed.

        ended : the method.
        """
        self.going = [method for method in self.going if method is not ended]
        if self.joined and self.going and 2 * len(self.going) <= len(self.joined):
            self.joined = [method for method in self.joined if method in self.going]
            self._join()


def _contacts(method: "Swept") -> OnLists:
    """Return the contacts of a method that steps a packing, which lie in lists."""
    assert isinstance(method.contacts, OnLists)
    return method.contacts


def _rest_of_plan(launch: Launch | None, calls: int, plan: Iterator[Launch]) -> Launch | None:
    """Return what is left of a launch (repeated calls of a kernel) after some of its calls were made; if nothing is
    left, the next launch of the plan, None at its end.

    launch : the launch; None to begin.
    calls : how many of its calls were made.
    plan : the launches that follow.
    """
    if launch is None or launch.calls == calls:
        return next(plan, None)
    return replace(launch, calls=launch.calls - calls, first=launch.first + calls)
