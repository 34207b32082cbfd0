"""A frustrated bearing in 100 lines: its least power, a bound below it, and a picture. docs/toy.md explains each line.

    python bearings_in_100_lines.py [nx ny nz [seed]]

Spheres of radius R touch on a lattice (ny = 1: discs on a square one) and can only spin. The top plane is driven, the
bottom plane rests. With staggered spins Omega = (-1)^(x+y+z) omega a contact slips by R |D|, D the difference of the
two Omega without its component along the contact. Friction takes mu F R |D| of power there; how small can the sum be?
"""

import sys

import numpy as np
import taichi as ti

RADIUS, NORMAL_FORCE = 0.5, 50.0
STIFFNESS, YIELDING = 1.7, 0.07  # of contacts, of spheres; times 8, the most of the lattice's Laplacian, below 1
GAP, STEPS, LOOK = 3e-7, 100_000, 200  # power and bound so near is the end, or so many steps; looked at so often


@ti.data_oriented
class Bearing:
    """spin : Omega_x, Omega_y (Omega_z is idle). force / F, mu : of contacts with the next sphere along x, y, z."""

    def __init__(self, shape: tuple, seed: int = 0) -> None:
        self.drive, self.top = ti.Vector([0.5**0.5, 0.5**0.5] if shape[1] > 1 else [0.0, 1.0]), shape[2] - 1
        self.mu = ti.field(ti.f64, (*shape, 3))
        self.force = ti.Vector.field(2, ti.f64, (*shape, 3))
        self.spin, self.ahead = (ti.Vector.field(2, ti.f64, shape) for _ in range(2))
        random, mu = np.random.default_rng(seed), np.zeros((*shape, 3))
        for axis, along in enumerate(np.eye(3, dtype=int)):
            values = random.uniform(0.1, 1.0, np.subtract(shape, along))
            mu[(*map(slice, values.shape), axis)] = values  # 0 where there is no next sphere
        self.mu.from_numpy(mu)
        rising = np.ones(shape)[..., None] * np.linspace(0.0, 1.0, shape[2])[:, None]
        self.spin.from_numpy(rising * self.drive.to_numpy())
        self.ahead.copy_from(self.spin)

    @ti.func
    def slip(self, spin: ti.template(), i, axis: ti.template()):
        difference = spin[i + ti.Vector.unit(3, axis, ti.i32)] - spin[i]
        if ti.static(axis < 2):
            difference[axis] = 0.0
        return difference

    @ti.func
    def torque(self, i):
        pull = ti.Vector([0.0, 0.0])
        for axis in ti.static(range(3)):
            pull += self.force[i, axis]
            if i[axis] > 0:
                pull -= self.force[i - ti.Vector.unit(3, axis, ti.i32), axis]
        return pull

    @ti.kernel
    def step(self):
        for i in ti.grouped(self.spin):  # friction grows like a spring, up to mu
            for axis in ti.static(range(3)):
                if self.mu[i, axis] > 0:
                    trial = self.force[i, axis] + STIFFNESS * self.slip(self.ahead, i, axis)
                    self.force[i, axis] = trial * ti.min(1.0, self.mu[i, axis] / ti.max(trial.norm(), 1e-300))
        for i in ti.grouped(self.spin):  # free spheres give way to the torque
            if 0 < i[2] < self.top:
                turned = ti.math.clamp(self.spin[i] + YIELDING * self.torque(i), 0.0, self.drive)
                self.ahead[i] = 2 * turned - self.spin[i]
                self.spin[i] = turned

    @ti.kernel
    def power_and_bound(self) -> ti.math.vec2:
        power, bound = ti.f64(0.0), ti.f64(0.0)
        for i in ti.grouped(self.spin):
            for axis in ti.static(range(3)):
                if self.mu[i, axis] > 0:
                    power += self.mu[i, axis] * self.slip(self.spin, i, axis).norm()
            if i[2] == self.top:
                bound -= self.torque(i).dot(self.drive)
            elif i[2] > 0:
                bound -= ti.max(self.torque(i), 0.0).dot(self.drive)
        return RADIUS * NORMAL_FORCE * ti.math.vec2(power, bound)

    def minimise(self) -> tuple[float, float]:
        for _ in range(0, STEPS, LOOK):
            for _ in range(LOOK):
                self.step()
            power, bound = self.power_and_bound()
            if power - bound <= GAP * power:
                break
        return power, bound


if __name__ == "__main__":
    ti.init(ti.cpu, default_fp=ti.f64, log_level=ti.ERROR)
    numbers = [int(word) for word in sys.argv[1:]] or [6, 6, 6]
    bearing = Bearing(tuple(numbers[:3]), *numbers[3:])
    print("power {:.9g}, and no less than {:.9g} is possible".format(*bearing.minimise()))
    plane = bearing.spin.to_numpy()[:, numbers[1] // 2] @ bearing.drive.to_numpy()  # 0 at the bottom, 1 at the top
    ti.tools.imwrite(np.kron(np.stack([plane, 0 * plane + 0.2, 1 - plane], 2), np.ones((32, 32, 1))), "bearing.png")
