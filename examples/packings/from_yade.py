"""Spheres and contacts of a YADE simulation: call save("packing.npz", {id: body}) in a script or console of yade.

Run with YADE 2023.02a. Only contacts between spheres are kept; a contact across a periodic side keeps its normal.
bodies : the driven bodies by id of sphere; their spins are those of the simulation.
"""

import numpy as np
from yade import O, Sphere


def save(file, bodies):
    spheres = [body for body in O.bodies if body is not None and isinstance(body.shape, Sphere)]
    number = {body.id: place for place, body in enumerate(spheres)}
    contacts = [
        contact
        for contact in O.interactions
        if contact.isReal and contact.id1 in number and contact.id2 in number and contact.phys.normalForce.norm() > 0
    ]
    np.savez(
        file,
        center=np.array([O.cell.wrap(b.state.pos) if O.periodic else b.state.pos for b in spheres], dtype=float),
        radius=np.array([b.shape.radius for b in spheres]),
        spin=np.array([b.state.angVel for b in spheres], dtype=float),
        driven=np.array([bodies.get(b.id, -1) for b in spheres]),
        contact=np.array([(number[c.id1], number[c.id2]) for c in contacts]),
        normal=np.array([c.geom.normal for c in contacts], dtype=float),  # from the first to the second
        normal_force=np.array([c.phys.normalForce.norm() for c in contacts]),
    )
