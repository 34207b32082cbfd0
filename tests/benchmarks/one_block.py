"""The passes of the kernels on one block of sites each, so that what they do can be counted."""

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.memory import BLOCKS, VALUES, in_range


@ti.data_oriented
class OneBlock:
    """Passes of `kernels`, which are DescentSweeps, CundallStrackSteps or a ContactStep."""

    def __init__(self, kernels):
        self.kernels, self.block = kernels, kernels.block

    @ti.kernel
    def sweep(self, values: VALUES, blocks: BLOCKS, row: int, first: int, x: int, y: int, step: float, sharp: float):
        for _ in range(1):
            strides, box = [in_range(x), in_range(y), 1], [[-9.0, -9.0, -9.0], [9.0, 9.0, 9.0]]
            numbers = [0.5 * step, step, sharp, box[0], box[1]]
            begin = in_range(first * self.block)
            carried = self.kernels.force_below(values, row, begin, begin, sharp)
            self.kernels.update_block(values, blocks, 0, False, row, begin, strides, numbers, carried)

    @ti.kernel
    def contact(self, values: VALUES, blocks: BLOCKS, row: int, first: int, x: int, y: int, step: float, sharp: float):
        for _ in range(1):
            strides = [in_range(x), in_range(y), 1]
            numbers = [step, sharp, step + 1.0, step + 2.0, step + 3.0, step + 4.0, step + 5.0]
            self.kernels.contact_pass(values, blocks, row, in_range(first * self.block), strides, numbers)

    @ti.kernel
    def sphere(self, values: VALUES, blocks: BLOCKS, row: int, first: int, x: int, y: int, step: float, sharp: float):
        for _ in range(1):
            strides = [in_range(x), in_range(y), 1]
            self.kernels.sphere_pass(values, blocks, row, in_range(first * self.block), strides, step)

    @ti.kernel
    def limit(self, values: VALUES, blocks: BLOCKS, row: int, first: int, x: int, y: int, step: float, sharp: float):
        for _ in range(1):
            strides, numbers = [in_range(x), in_range(y), 1], [step, sharp, step + 0.7]
            self.kernels.limit_block(values, blocks, row, in_range(first * self.block), strides, numbers)

    @ti.kernel
    def gather(self, values: VALUES, blocks: BLOCKS, row: int, first: int, x: int, y: int, step: float, sharp: float):
        for _ in range(1):
            strides = [in_range(x), in_range(y), 1]
            self.kernels.gather_block(values, blocks, row, in_range(first * self.block), strides)
