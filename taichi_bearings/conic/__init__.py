"""The Coulomb minimum as a conic programme: contact systems, cones, central path, and settling of contact states.

The problem is to minimise the sum over contacts of mu b + eta |v|^2 / 2 over spins and bounds b >= |v|, where v is the
slip. Its dual is to find contact forces f in balance with |f| <= mu. Interior-point steps follow the central path, on
which the product of slip bound and friction margin is the same for all contacts, down to 0.

Words and symbols in this folder:

==================  ====================================================================================
here                is
==================  ====================================================================================
n                   contacts of a system; "(n,) mask" marks some of them
d                   most slip components (rows) of a contact, 1 or 2
unknowns            number of unknown components of the free spins
S, samples          samples of one system, side by side
C, R, N, E          spin components, samples, spheres and contacts of a scene
difference          slips v (d, n): differences of spins across contacts
bound               b (n,), bounds on the slip speeds
friction            mu F_n (n,), largest friction force, in units of its mean
dual                minus the friction force, (d, n)
margin              1 - |dual| / friction, the share of its friction that a contact has left
product             bound times what is left of the friction, the same for all contacts on the path
excess, gap         cost less what the forces prove; the same over the cost
stick, slip         margin stays and slip vanishes at the end of the path, or the other way round
tied                spins made equal across contacts that do not slip: one unknown for all of them;
                    but a contact state TIED means: slips at some minima and rests at others
at limit            contacts that bear all their friction and yet do not slip
head                one chosen unknown of each set of tied spins without a driven plane
smooth              contacts that have left their cones and obey the friction law exactly
==================  ====================================================================================
"""
