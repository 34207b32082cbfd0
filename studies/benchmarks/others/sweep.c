/* A subgradient sweep of descent under Coulomb friction in plain loops, one thread: what a C compiler makes of it.

   Compiled with -DREAL=double -DDIMENSION=3 -DCOMPONENTS=2 "-DCOUNT={1,1,2}" "-DKEPT={{1,0},{0,0},{0,1}}": the spin
   components that the contacts of each axis feel. Rows are `length` numbers long; stride: the upper neighbour. */
#include <math.h>

typedef REAL real;
static const int count[DIMENSION] = COUNT, kept[DIMENSION][2] = KEPT;

static inline void add_pull(const real *spin, real friction, long length, int axis, long below, long above, real sign,
                            real *pulled)
{
    if (count[axis] == 1) {
        real d = (real)1e12 * (spin[kept[axis][0] * length + above] - spin[kept[axis][0] * length + below]);
        d = d < -1 ? -1 : d;
        pulled[kept[axis][0]] += sign * friction * (d > 1 ? 1 : d);
    } else if (count[axis] == 2) {
        real d0 = spin[kept[axis][0] * length + above] - spin[kept[axis][0] * length + below];
        real d1 = spin[kept[axis][1] * length + above] - spin[kept[axis][1] * length + below];
        real size = d0 * d0 + d1 * d1, share = sign * friction / (real)sqrt(size > (real)1e-30 ? size : (real)1e-30);
        pulled[kept[axis][0]] += share * d0;
        pulled[kept[axis][1]] += share * d1;
    }
}

void sweeps(long number, long first, long sites, long length, const long *stride, real *even, real *odd,
            const real *restrict friction, const real *restrict step)
{
    for (long turn = 0; turn < number; turn++) {
        const real *restrict from = turn % 2 ? odd : even;
        real *restrict to = turn % 2 ? even : odd;
#pragma GCC ivdep
        for (long p = first; p < first + sites; p++) {
            real pulled[COMPONENTS] = {0};
#pragma GCC unroll 3
            for (int axis = 0; axis < DIMENSION; axis++) {
                long s = stride[axis];
                add_pull(from, friction[axis * length + p], length, axis, p, p + s, 1, pulled);
                add_pull(from, friction[axis * length + p - s], length, axis, p - s, p, -1, pulled);
            }
#pragma GCC unroll 3
            for (int c = 0; c < COMPONENTS; c++)
                to[c * length + p] = from[c * length + p] + step[c * length + p] * pulled[c];
        }
    }
}
