"""The Coulomb minimum as a conic programme: contact systems, cones, central path, and settling of contact states.

The problem is to minimise the sum over contacts of mu b + eta |v|^2 / 2 over spins and bounds b >= |v|, where v = K u +
v0 is the slip, linear in the spins u. Its dual is to find contact forces f in balance, K^T f = 0, with |f| <= mu (plus
a viscous force eta v where there is a viscosity eta). The pair (b, v) and the pair (mu, -f) of each contact are points
of second-order cones: head not smaller than the length of the tail. Interior-point steps (central_path.py, iterate.py)
follow the central path, on which the product mu b - v . f is the same for all contacts, down to 0.
Near its end resolution.py decides which contacts slip; its head explains how, with an example.

Files: contact_system.py has the map from spins to slips, contraction.py the same map with some contacts tied;
newton_matrix.py and rows.py have the linear systems of a step, central_path.py the steps, descent.py the steps of many
samples; resolution.py, last_decades.py, polish.py, slipless_forces.py, multipliers.py and ties.py find out which
contacts slip; proximal.py and friction_stage.py make steps in time; shared.py keeps what samples of one network share.

Units: spins in units of the imposed jump, friction and forces in units of the mean friction of the sample, so that
numbers are of order one. A "torque over the mean friction" is therefore just a number.

Words and symbols in this folder:

==================  ====================================================================================
here                is
==================  ====================================================================================
n                   contacts of a system; "(n,) mask" marks some of them
d                   most slip components (rows) of a contact, 1 or 2
unknowns            number of unknown components of the free spins
S, samples          samples of one network that are computed together, on the last axis of arrays
C, R, N, E          spin components, samples, spheres and contacts of a scene
K, operator         matrix (d n, unknowns) from spins to slips; its transpose gives torques of forces
difference          slips v (d, n): differences of spins across contacts
bound               b (n,), bounds on the slip speeds
friction            mu F_n (n,), largest friction force, in units of its mean
dual                minus the friction force, (d, n)
viscosity           eta (n,), viscous force over slip speed
margin              1 - |dual| / friction, the share of its friction that a contact has left
product             friction times bound less slip times force, the same for all contacts on the path
cost                function that is minimised: the power, or with viscosity sum of mu |v| + eta |v|^2 / 2
excess, gap         cost less the lower bound that the forces prove; excess over cost
stick               of a contact: at the end of the path its slip vanishes and its margin stays above 0
slip                of a contact: at the end of the path its slip stays and its margin vanishes
decided             it is clear whether a contact sticks or slips
tied                of a contact: the spins at its two ends are made equal, as one unknown;
                    but the contact state TIED means: slips at some minima and rests at others
at limit            contacts that bear all their friction and yet do not slip
head                of a set of tied spins without a driven plane: one chosen spin of it;
                    of a point in a cone: its first number, bound or friction; the tail is slip or force
room                friction less the size of the force, (n,)
smooth              of a contact: in no cone any more; its force obeys the friction law exactly
settle, resolve     to decide which contacts slip at the exact minimum
staggered spins     spins with the sign of every second sphere changed, so that slips are differences
Pair                sum of two doubles, (high, low): some 106 bits (numerics/double_double.py)
==================  ====================================================================================
"""
