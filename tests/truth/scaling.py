"""The scaling of Nesterov and Todd of one second-order cone."""

from tests.truth.cones import determinant, dot, middle


class Scaling:
    """W of Nesterov and Todd with W z = W^-1 s = point, for one cone."""

    def __init__(self, s, z):
        det_s, det_z = determinant(s).mid(), determinant(z).mid()
        root_s, root_z = det_s.sqrt().mid(), det_z.sqrt().mid()
        s, z = middle(x / root_s for x in s), middle(x / root_z for x in z)
        gamma = ((1 + dot(s, z)) / 2).sqrt().mid()
        gamma *= 2
        self.w = middle([(s[0] + z[0]) / gamma, *((x - y) / gamma for x, y in zip(s[1:], z[1:], strict=True))])
        self.beta_square = (root_s / root_z).mid()
        self.beta = self.beta_square.sqrt().mid()
        self.point = self.times([x * root_z for x in z])
        w0 = self.w[0]
        self.h00 = ((2 * w0 * w0 - 1) / self.beta_square).mid()  # of W^-2
        self.h01 = middle(-2 * w0 * x / self.beta_square for x in self.w[1:])
        shrink = (2 / (2 * w0 * w0 - 1)).mid()
        self.stiffness = [
            middle(((i == j) - shrink * x * y) / self.beta_square for j, y in enumerate(self.w[1:]))
            for i, x in enumerate(self.w[1:])
        ]

    def _turned(self, v, sign):
        w0, w1 = self.w[0], self.w[1:]
        along = dot(w1, v[1:])
        factor = sign * v[0] + along / (1 + w0)
        return [w0 * v[0] + sign * along, *(y + factor * x for x, y in zip(w1, v[1:], strict=True))]

    def times(self, v):
        return middle(self.beta * x for x in self._turned(v, 1))

    def inverse_times(self, v):
        return middle(x / self.beta for x in self._turned(v, -1))
