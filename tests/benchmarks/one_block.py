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
            strides, begin = [in_range(x), in_range(y), 1], in_range(first * self.block)
            numbers = [step, sharp, -9.0, -9.0, -9.0, 9.0, 9.0, 9.0, 0.0]
            carried = self.kernels.enter(values, row, begin, numbers, 2)
            self.kernels.walk(0, values, blocks, row, begin, strides, numbers, 2, carried)

    @ti.kernel
    def contact(self, values: VALUES, blocks: BLOCKS, row: int, first: int, x: int, y: int, step: float, sharp: float):
        for _ in range(1):
            strides = [in_range(x), in_range(y), 1]
            numbers = [step, sharp, step + 1.0, step + 2.0, step + 3.0, step + 4.0, step + 5.0, step]
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
