"""The benchmark scene in YADE, run by its own interpreter: yade -n -x yade_scene.py '{...}'.

Spheres overlap a little, so that the normal force is constant; translations are blocked, of driven spheres rotations
too. ViscElMat connects two spheres in series, so each carries twice the stiffness and damping of the contact. While its
spring holds, YADE adds the damper's force without a limit, so that random spins slow down sooner than ours; the state
of rest is the same.

Request and answer are as in lammps_scene.py, without `style`; seconds are processor time, divided by its threads.
"""

import json
import math
import sys
import time
from typing import Any

import numpy as np
from yade import (
    Bo1_Sphere_Aabb,
    ForceResetter,
    Ig2_Sphere_Sphere_ScGeom,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_ViscElMat_ViscElMat_ViscElPhys,
    Law2_ScGeom_ViscElPhys_Basic,
    NewtonIntegrator,
    O,
    ViscElMat,
    utils,
)

OVERLAP = 1e-4
ANY, DRIVEN = 1, 2  # groups; driven spheres do not touch one another


def main(request: dict[str, Any]) -> None:
    """Run the scene in YADE, and print the answer as JSON: seconds of processor time for the timed steps, and the
    number of contacts.

    request : `shape`, numbers of spheres along three axes; `steps` to time and `warm_up` steps before; `stiffness`,
        `damping` and `friction` of contacts; `normal_force`; `time_step`; `spin`, a file with initial spins (*N
        spheres, 3); and optionally `final`, a file for those at the end.
    """
    shape, spin = request["shape"], np.load(request["spin"])
    material = O.materials.append(
        ViscElMat(
            kn=2 * request["normal_force"] / OVERLAP,
            ks=2 * request["stiffness"],
            cn=0.0,
            cs=2 * request["damping"],
            frictionAngle=math.atan(request["friction"]),
        )
    )
    for site in np.ndindex(*shape):
        body = utils.sphere([float(n) for n in site], (1 + OVERLAP) / 2, material=material)
        driven = site[-1] in (0, shape[-1] - 1)
        body.mask = ANY | DRIVEN if driven else ANY
        body.state.blockedDOFs = "xyzXYZ" if driven else "xyz"
        body.state.mass, body.state.inertia = 1.0, [0.1] * 3  # 2 m R^2 / 5
        body.state.angVel = [float(value) for value in spin[site]]
        O.bodies.append(body)
    O.engines = [
        ForceResetter(),
        InsertionSortCollider([Bo1_Sphere_Aabb()], avoidSelfInteractionMask=DRIVEN),
        InteractionLoop(
            [Ig2_Sphere_Sphere_ScGeom()], [Ip2_ViscElMat_ViscElMat_ViscElPhys()], [Law2_ScGeom_ViscElPhys_Basic()]
        ),
        NewtonIntegrator(damping=0),
    ]
    O.dt = request["time_step"]
    O.run(request["warm_up"] + 1, True)  # 0 would mean without end
    began = time.process_time()
    O.run(request["steps"], True)
    seconds = (time.process_time() - began) / O.numThreads
    if "final" in request:
        found = np.empty((*shape, 3))
        for site, body in zip(np.ndindex(*shape), O.bodies, strict=True):
            found[site] = body.state.angVel
        np.save(request["final"], found)
    print(json.dumps({"seconds": seconds, "contacts": O.interactions.countReal()}))


main(json.loads(sys.argv[-1]))
