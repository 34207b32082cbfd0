"""What follows from any spins and forces: bounds on the least power, and which contacts slip."""
