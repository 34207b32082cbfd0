"""What is rigorously true of spins and friction: the problem, the theorems and their symbols, and where each is proven.

The head of each file says what is proven there, with which symbols, in which steps, most with a small example. To begin
with: bounds.py, then resting.py (a proof of one page), curvature.py, states.py. Proofs for normals in any direction are
in oblique.py, centre.py, among_motions.py, exact_motions.py, loops.py and borne.py, those for many minima in
tied_minima.py.

The problem
-----------
Spheres at fixed places touch at contacts (i, j) with unit normals n from i to j. With u = R omega the surface of j
slips past that of i with v = -(u_i + u_j) x n; spins of driven spheres are imposed, the others are free. A contact that
slips by v has the potential phi(v) = mu F_n |v| + eta |v|^2 / 2, of which either term may be missing. Let y = K u + b
be the slips of free spins u, with the sign of (u_i + u_j) x n = -v; b are those of what is imposed with u = 0:

    (P)    P* = least Phi(u),   Phi(u) = sum over contacts of phi(y)

where P* is the least power with friction alone, half of it with damping alone. Friction F on the second spheres
points along y, and its torque on both spheres is -R n x F. Where it is in balance, K^T F = 0, the driven spheres do
the work W(F) = F . b:

    (D)    P* = largest W(F) - sum over contacts of phi*(F) among all F in balance,
           phi*(F) = max(|F| - mu F_n, 0)^2 / (2 eta); without damping 0 up to mu F_n and infinite beyond

(Fenchel's duality; with friction alone the lower bound theorem of plastic limit analysis). A *minimum* is a u* that
solves (P), y* its slips, and *optimal* is any friction F* that solves (D). Numbers are enclosures, sums of two doubles
with a bound on their error (enclosure.py), and all bounds are rounded outwards.

The theorems
------------
1. Bounds. Phi(u) >= P* for any u. For any F, in balance or not, with torques r = K^T F left over, and a factor s at
   which s F is inside the discs of contacts without damping,
   P* >= s (W(F) + r . u*) - sum of phi*(s F) at any minimum u*. [bounds.py]
2. Where minima are. Components that do not mix (discs; normals along the axes) can be clipped to what is imposed, of
   lattices in each layer, and no slip grows: so r . u* is bounded. Else springs take r away, and what rounding leaves
   of it is paid for at |D^-1 u*| <= (1 + |q^1/2 b|) / sigma, with a proven floor sigma. [judged_network.py, springs.py]
3. No slip at all. P* = 0 where nothing driven is touched, where signs by which neighbours differ agree with all that is
   imposed, and where contacts roll exactly or their rows of K are independent. [slipless_state.py, exact_motions.py]
4. Slackness. At every minimum and for every optimal friction phi(y*) + phi*(F*) = F* . y*, contact by contact. So a
   contact is *slipless*, it slips at no minimum, if one optimal F* is below its limit. [states.py]
5. Excess. Let E be Phi(u) less the lower bound that F proves by 1. At every minimum the sum of phi(y*) + phi*(F) - F .
   y* is at most E, and with damping the sum of eta |y* - y|^2 / 2 as well. [states.py]
6. Cuts. In one component minima are mixtures of lightest cuts. For a contact in one of these, mu F_n - |F| is at most E
   over the jump. [minima_by_cuts.py]
7. One minimum. Let contacts T rest, and let the curvature of Phi along all motions in which they do be tau or more, in
   some norm. If the slope of Phi is below 0.72 tau rho, and no slip changes by more than a quarter within rho, then (P)
   with T at rest has one minimum there. If friction of T within its discs can balance the torques of the other contacts
   there, this is the only minimum of (P). [curvature.py for normals along the axes, oblique.py, centre.py,
   among_motions.py and exact_motions.py for others; floors of curvatures by rounded_elimination.py, with Higham's bound
   on the error of a factorisation]
8. Parts at rest. Contacts that can all rest at once rest at every minimum if friction of theirs, below its limits, can
   balance the torques of optimal friction elsewhere. [resting.py; loops.py and borne.py where loops beside them cannot
   roll as normals are rounded]
9. Ties. Where frictions cancel exactly, spheres a and b can move by y_a and y_b at no cost, as long as no slip t
   between them turns backwards: t + y_b - y_a >= 0. Shortest paths say which slips are 0 at some minima but not at all:
   such contacts are *tied*. [tied_minima.py, with pulls.py, between_two.py and oblique_limits.py]

The entry point is Judgement(scene, spin, spin_rounding, friction) in judgement.py: it has the power, both bounds, their
gap, and what is proven of the state of each contact at every minimum. certificate.py has theorem 1 in plain doubles
with an allowance for rounding, for methods that have not finished. Reported results use it only for contact laws that
users have written.

The words
---------
===============  ============================================================================================
word             meaning
===============  ============================================================================================
acts             a contact that has a coefficient and a free end
part             spheres that contacts between free spheres join
reached          a free sphere whose part touches driven spheres
counts           a contact that acts at a reached sphere; no other contact dissipates at any minimum
feels            a contact that counts and slips with a component of the spins
rests            a contact that does not slip at any minimum, or is assumed not to
still            a contact whose slip is exactly 0 in the stored spins
at hand, given   said of the stored spins and friction, from which everything is proven
law              says the friction of a contact from its slip y: mu F_n y / |y| + eta y
lattice          spheres on sites; its normals are along the axes
packing          spheres anywhere; its normals may have any direction (oblique)
domain           spheres that resting contacts join in a component, so that they turn as one
floor            a proven lower bound of eigenvalues or singular values
margin           mu F_n less the size of F
signed spin      spin times +1 or -1, different for neighbours: where signed spins are equal nothing slips
odd loop         a loop of an odd number of contacts: no signs differ across all of them
components mix   they do not if each contact slips with each component of the spins separately
===============  ============================================================================================

The symbols
-----------
=============  =======================  ==========================================================
here           in the code              is
=============  =======================  ==========================================================
n, m           free, acts (lengths)     spheres and contacts of all samples, one after the other
R              count                    samples, of a lattice or of one packing
k              components, k            a component of spins: of discs one, of spheres three
u              spin                     R omega; of lattices signed, and measured from the bottom
y              slips(), slip            slips, and their sizes
F, n x F       friction, moment         friction on the second sphere; minus its torque on both
mu F_n, eta    friction_limit, damping  friction that a contact bears; its damping
b              imposed                  slips by what is imposed; `imposed` has its spins
r              torques()                torques over the radius that friction leaves over
E              bounds.excess            upper bound less lower bound
1 / s          bounds.worst             largest friction over its limit
s F            bounds.size              its size
tau, sigma^2   floor()                  proven floors of eigenvalues
T              motion.rests             contacts that are taken to rest
=============  =======================  ==========================================================

Speeds are in units of `speed_unit`, forces of `force_unit`: powers of two, but for the radius. Oracles that share no
code with this folder test the theorems in tests/proof, tests/properties and tests/stress: exact fractions, networkx,
Clarabel, and Newton's method and the paper's formulas in sixty and eighty digits.
"""
