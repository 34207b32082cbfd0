"""The Coulomb law with a single spin component, solved exactly: its least power is a minimum cut of planar grids.

A component k is coupled only by the contacts that are not along k, so that a square lattice, or each plane k = constant
of a cubic one, is a grid of its own. With one component the power is a sum of weighted |differences|, and some
minimiser takes no other values than the two driven ones (equations.md, 5). So all slip is at the interface between the
spheres that rotate with the bottom and those that rotate with the top, and that is the minimum cut of the grid. The
maximum flow proves it and is the friction (planar/cuts.py). Every minimum is a mixture of minimum cuts, grid by grid: a
contact slips at all minima if it is in all of these cuts, and at some if it is in some; then it is *tied*. On a
periodic grid the cut is the lightest ring around it, and a general maximum flow finds it.

Letters: R samples; a *plane* is the grid of one layer across the axis k.
"""

from collections.abc import Iterator

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.exact_cuts import cuts_between
from taichi_bearings.numerics.minimum_cut import cut_lattice, edges_of, graph_of_lattice
from taichi_bearings.numerics.planar import MinimumCuts, minimum_cuts
from taichi_bearings.proof.certificate import largest_unbalanced_torque, work_and_bound
from taichi_bearings.proof.contact_state import ContactState, all_slipless
from taichi_bearings.scene import Progress, Scene
from taichi_bearings.solvers.part import Part


class GridCuts(Part):
    """The planar cut of a lattice. Its only iteration finds the minimum cut of each plane, a grid of contacts that
    couple one spin component.

    scene : the lattice with its R samples.
    component : number of the axis of that spin component; the planes are the layers across it.
    top : (planes,), imposed spin of the top less that of the bottom in each plane, 1/time.
    staggered, force, states : (1, R samples, *N spheres) spins with signs that alternate between neighbours, 1/time;
        (1, R, E contacts) contact forces; and (R, E) contact states.
    tied : (R, planes), number of contacts that are in some but not in all minimum cuts.
    weight, further : (R, planes), weight of the minimum cut, and by how much the lightest other one is heavier, both
        times the imposed spin difference: proportional to their powers. `further` is infinite where there is no other
        cut, and not-a-number where it is not known, as where absent contacts alone are cut.
    """

    def __init__(self, scene: Scene, spin_axes: tuple[int, ...], spin: np.ndarray) -> None:
        """Prepare to cut: find the imposed spin difference of each plane. All forces begin with 0, and all contacts as
        slipless.

        scene : the lattice with its R samples.
        spin_axes : number of the axis of the one spin component that is computed, as a tuple.
        spin : (R samples, *N spheres, 3), in 2D (R, *N), spins, 1/time, which stay until the cut is made.
        """
        self.scene, self.spin_axes = scene, spin_axes
        (self.component,) = spin_axes
        self.staggered = scene.staggered_spin(spin, self.spin_axes)
        self.force, self.states = np.zeros((1, *scene.coefficient.shape)), all_slipless(scene)
        self.top = self.scene.lattice.by_plane(scene.top_spin(self.spin_axes)[..., None], self.component)[0, :, 0, 0]
        # numbers of each plane, which the class explains, before any cut is known
        planes = len(self.top)
        self.tied = np.zeros((scene.replicas, planes), dtype=np.int64)
        self.weight, self.further = np.zeros(self.tied.shape), np.full(self.tied.shape, np.inf)
        self.iteration = 0

    def advance(self, steps: int) -> None:
        """Find the minimum cut of every plane. Where top and bottom have the same spin there is nothing to cut, and all
        spheres of the plane get this spin.

        steps : not used, as the first iteration finds all cuts.
        """
        self.iteration += 1
        spins = self.scene.lattice.by_plane(self.staggered[0], self.component)
        spins[:, self.top == 0] = 0.0  # no jump: all rotate with the bottom
        # friction coefficients of all planes with a jump, along the rows and along the height
        height = self.scene.lattice.height_axis
        (sideways,) = (axis for axis in range(height) if axis != self.component)
        coefficient = self.scene.lattice.by_axis(self.scene.coefficient)
        replica, plane = (index.ravel() for index in np.indices((self.scene.replicas, len(self.top))))
        replica, plane = replica[self.top[plane] != 0], plane[self.top[plane] != 0]
        of_axes = (self.scene.lattice.by_plane(coefficient[axis], self.component) for axis in (sideways, height))
        weights = [of[replica, plane] for of in of_axes]
        grid = self.scene.lattice.across(self.component)
        cuts_of = ring_cuts if grid.periodic else minimum_cuts
        for part, cuts in cuts_of(*weights) if len(plane) else ():
            where = replica[part], plane[part]
            spins[where] = np.where(cuts.above, self.top[plane[part], None, None], 0.0)
            # contacts along the rows and along the height whose ends are on different sides of the cut
            along, upward = (cuts.above[low] != cuts.above[high] for low, high in map(grid.along, range(2)))
            along, upward = (cut & (of[part] > 0) for cut, of in zip((along, upward), weights, strict=True))
            self._store(sideways, where, along, cuts.sideways_flow, cuts.sideways_tied)
            self._store(height, where, upward, cuts.upward_flow, cuts.upward_tied)
            self.tied[where] = cuts.tied
            jump = abs(self.top[plane[part]])
            self.weight[where] = cuts.weight * jump
            self.further[where] = np.where(cuts.weight > 0, (cuts.next_weight - cuts.weight) * jump, np.nan)

    def _store(
        self, axis: int, where: tuple[np.ndarray, np.ndarray], cut: np.ndarray, flow: np.ndarray, tied: np.ndarray
    ) -> None:
        """Store friction and states of the contacts along one lattice axis, in some planes.

        axis : number of the lattice axis.
        where : two arrays (planes,), the sample and the number of each plane.
        cut, tied : (planes, ...), masks of the contacts that are in the cut that was found, and of those that are in
            some but not in all minimum cuts.
        flow : (planes, ...), maximum flow in the contacts, in units of the normal force.
        """
        friction = flow * (np.sign(self.top[where[1], None, None]) * self.scene.normal_force)
        self.scene.lattice.by_plane(self.scene.lattice.by_axis(self.force[0])[axis], self.component)[where] = friction
        states = self.scene.lattice.by_plane(self.scene.lattice.by_axis(self.states)[axis], self.component)
        states[where] = np.where(tied, ContactState.TIED, np.where(cut, ContactState.SLIPPING, states[where]))

    def _next_over_minimum(self) -> np.ndarray:
        """Return the power of the second lightest cut over the power of the lightest, (R samples,): 1 where a plane has
        two lightest cuts, above 1 elsewhere, infinite without another cut, and not-a-number where it is not known.
        """
        # the least weight that another cut of a plane adds; not-a-number if one is unknown, unless another is 0
        least = np.where((self.further == 0).any(axis=1), 0.0, self.further.min(axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = 1 + least / self.weight.sum(axis=1)
        found: np.ndarray = np.where(least > 0, np.maximum(ratio, np.nextafter(1.0, 2.0)), ratio)
        return found

    def progress(self) -> Progress:
        """Return the progress: the start before the first iteration; after it the minimum, with forces, contact states
        and lower bound.

        It has two findings, (R samples,): `cut_is_unique`, True if each plane has one minimum cut, and
        `next_cut_over_minimum`, the power of the second lightest cut over the power of the lightest. A cut of a cubic
        lattice is a cut of every plane, and the second lightest differs from the lightest in one plane.
        """
        scene, axes, cut = self.scene, self.spin_axes, self.iteration > 0
        unique = self.tied.sum(axis=1) == 0
        findings = {
            "cut_is_unique": unique,
            "next_cut_over_minimum": self._next_over_minimum(),
        }
        return Progress(
            iteration=self.iteration,
            staggered=self.staggered.copy(),
            spin_axes=axes,
            force=self.force.copy(),
            objective=scene.objective(self.staggered, axes),
            lower_bound=work_and_bound(scene, self.force, axes)[1] if cut else np.zeros(scene.replicas),
            resolution=float(np.finfo(np.float64).eps) * scene.lattice.radius * scene.fastest,
            largest_balance_residual=largest_unbalanced_torque(scene, self.force, axes),
            exhausted=cut,
            state=self.states.copy() if cut else None,
            settled=np.full(scene.replicas, cut),  # so that the cut is taken even if the start seems lower by rounding
            states_believed=unique if cut else None,
            findings=findings if cut and self.top.any() else {},
        )


def ring_cuts(sideways: np.ndarray, upward: np.ndarray) -> Iterator[tuple[slice, MinimumCuts]]:
    """Yield the cuts of least weight between the bottom row and the top row of each grid, one grid at a time.

    sideways : weights (B, w, h) of contacts along the rows of B grids of w columns and h rows; the last column's are
        those with the first column.
    upward : weights (B, w, h - 1) of contacts between rows.
    yields : the number of the grid as a slice of length 1, and its cut: side of each sphere, flow, ties and weight. The
        weight of the lightest other cut, `next_weight`, is not known (NaN) where cuts do not tie.

    A flow of rounded weights shows for most spheres that they are on one side of all lightest cuts. The part of the
    grid between these is cut again with exact weights.
    """
    for grid in range(len(upward)):
        weight = sideways[grid], upward[grid]
        cut, lattice = cut_lattice(weight), Lattice.of(weight)
        node, ends = graph_of_lattice(lattice)
        above, open_ = np.zeros((2, int(node.max()) + 1), dtype=bool)
        above[node], open_[node] = cut.above, cut.between
        tied = np.zeros(ends.shape[1], dtype=bool)
        if open_.any():
            exact, place = cuts_between(ends, edges_of(weight), above, open_)
            tied, above = exact.some & ~exact.every, exact.above[place]
        # flow and ties of the edges, on the contacts; those along the end rows, which are no edges, have 0
        sideways_flow, upward_flow = np.zeros(sideways.shape[1:]), np.zeros(upward.shape[1:])
        sideways_tied, upward_tied = (np.zeros(flow.shape, dtype=bool) for flow in (sideways_flow, upward_flow))
        of_edges = (sideways_flow, upward_flow, cut.flow * cut.unit), (sideways_tied, upward_tied, tied)
        for along, up, values in of_edges:
            inner, rest = np.split(values, [along[:, 1:-1].size])
            along[:, 1:-1], up[:] = inner.reshape(along[:, 1:-1].shape), rest.reshape(up.shape)
        next_weight = np.array(cut.weight if tied.any() else np.nan)
        flows_and_ties = sideways_flow, upward_flow, sideways_tied, upward_tied
        found = above[node], *flows_and_ties, np.array(cut.weight), next_weight
        yield slice(grid, grid + 1), MinimumCuts(*(values[None] for values in found))
