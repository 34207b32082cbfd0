"""The Coulomb minimum as a conic programme: contact groups, cones, central path, settling of contact states."""
