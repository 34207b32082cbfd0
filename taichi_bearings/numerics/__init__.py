"""What knows no friction: factorisation, transforms, cuts, sums of two doubles."""
