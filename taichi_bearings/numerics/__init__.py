"""Mathematics that knows no friction: factorisation, motions without slip, transforms, cuts, sums of two doubles."""
