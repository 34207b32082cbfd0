"""Bottlenecks of slipless networks beside those of random ones: python -m tests.benchmarks.bottleneck_table

Certified minima of the paper's scene, seeds 0, 1, ...; beside each the null model: as many slipless contacts of each
axis, at random places. Mean and standard error over the samples that span.
"""

import argparse
import bisect

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.analysis.bottlenecks import LEAST_LOAD, Bottlenecks
from taichi_bearings.analysis.network import SliplessNetwork, network_of
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene


def shuffled(network, seed):
    """As many links of each axis, anywhere but between driven spheres."""
    random, lattice, anywhere = np.random.default_rng(seed), network.lattice, np.zeros_like(network.slipless)
    for axis in range(lattice.dimension):
        can_slip = (lattice.axis == axis) & ~lattice.between_driven
        anywhere[can_slip] = random.permutation(network.slipless[can_slip])
    return SliplessNetwork(lattice, anywhere)


def slip_that_would_span(lattice, slip):
    """Least slip speed such that the contacts that slip no faster join bottom and top: halving the sorted list."""
    speeds = np.unique(slip)

    def spans(threshold):
        return SliplessNetwork(lattice, (slip <= threshold) & ~lattice.between_driven).spans

    return speeds[bisect.bisect_left(speeds, True, key=spans)]


def measures(network):
    """Name and value of everything in the table."""
    found = Bottlenecks(network)
    bottom, top = (network.touched_of(body) for body in (0, network.bodies - 1))
    return {
        "links": len(network.axis),
        "share of the free spheres in the spanning piece": network.spanning_fraction,
        "links outside the backbone": float((~found.backbone).mean()),
        "links that part the planes alone": int(found.parting.sum()),
        "samples with such a link, share": bool(found.parting.any()),
        "paths that share no link": network.disjoint_paths,
        "bottom spheres on links": len(bottom),
        "top spheres on links": len(top),
        "shortest path, links": max(0, len(network.shortest_path) - 1),
        "mean distance of pairs, links": found.betweenness.mean_distance,
        "planes x = const on a shortest path": network.path_planes[0],
        "connected pairs, share": found.betweenness.pairs / max(1, len(bottom) * len(top)),
        "pairs through the top link, share": found.share.max(),
        "links with 9/10 of the pairs": int((found.share >= 0.9).sum()),
        "links on any shortest path, share": float((found.share > LEAST_LOAD).mean()),
        "effective number of loaded links": found.effective_links,
    }


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--shape", default="10x10x10")
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--spin-bottom", type=float, default=0.1)
    options.add_argument("--threads", type=int, default=1)
    given = options.parse_args()
    runtime.start(threads=given.threads)
    shape = tuple(int(n) for n in given.shape.split("x"))
    samples, undecided, missing = {"minimum": [], "random": []}, 0, []
    for seed in range(given.seeds):
        scene = make_scene(shape, seeds=(seed,), spin_bottom=given.spin_bottom)
        solution = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-8))
        network = network_of(scene.lattice, solution.state[0])
        undecided += int((solution.state == ContactState.UNDECIDED).sum())
        if not network.spans:
            unit = scene.lattice.radius * scene.jump
            missing.append(slip_that_would_span(scene.lattice, solution.slip[0]) / unit)
        for name, one in (("minimum", network), ("random", shuffled(network, seed))):
            if one.spans:
                samples[name].append(measures(one))
    spans = {name: f"{len(rows)} of {given.seeds}" for name, rows in samples.items()}
    print(f"{given.shape}, spin_bottom {given.spin_bottom:g}, {given.seeds} seeds, {undecided} undecided contacts\n")
    print("| | slipless network | as many at random |\n|---|---|---|")
    print(f"| samples that span | {spans['minimum']} | {spans['random']} |")
    columns = [
        {key: mean_and_error([row[key] for row in rows]) for key in rows[0]} for rows in samples.values() if rows
    ]
    for key in columns[0]:
        print(f"| {key} | {' | '.join(column[key] for column in columns)} |")
    if missing:
        print("\nslips over R times the jump that must pass for none before the other samples span:")
        print(", ".join(f"{np.quantile(missing, share):.1e} ({share:.0%})" for share in (0, 0.25, 0.5, 0.75, 1)))


def mean_and_error(values):
    """Mean and its standard error over the samples, as text."""
    error = np.std(values, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return f"{np.mean(values):.4g} ± {error:.2g}"


if __name__ == "__main__":
    main()
