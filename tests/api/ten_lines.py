"""The ten lines of the front door, to be run as a script, as a user would: with no guard and in an empty folder."""

import taichi_bearings as tb
from tests.api.forbidden import no_writing

with no_writing():
    scene = tb.Scene.random((5, 5, 6), seed=3, spin_bottom=0.1)
    best = tb.solve(scene, tolerance=1e-9)
    course = tb.solve(scene, tb.CundallStrack(stiffness=1e6), start="random", duration=0.01)
    net = tb.analyse(best)
    answers = list(tb.solve_many([tb.Scene.random((4, 5), seed=seed) for seed in range(2)]))
print(best.status, best.gap <= 1e-9, best.spin.shape, course.status, net.spans, len(answers))
figure = best.plot("spins")
best.save("outputs/mine")
again = tb.load("outputs/mine")
print(again.power == best.power, (again.spin == best.spin).all(), tb.analyse(again).spans == net.spans)
