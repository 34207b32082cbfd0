"""Minima whose torques balance to thirty digits."""

from decimal import Decimal

import pytest

from tests.verifier.laboratory import Laboratory, dot
from tests.verifier.test_bounds import samples_of, solved


@pytest.mark.usefixtures("needs_f64", "taichi_runtime")
@pytest.mark.parametrize("seed", [1, 6])
def test_slipping_contacts_leave_no_torque_on_any_domain(seed):
    """mu F_n along the slip of Eq. 2, in 80 digits and the laboratory frame, summed over what moves as one."""
    solution = solved((4, 3, 5), {"seeds": (seed,)}, "interior-point")
    assert solution.states_proven[0]
    laboratory = Laboratory(samples_of(solution))
    for component in (0, 1):
        label = {site: site for site in laboratory.spin}

        def root(site, label=label):
            while label[site] != site:
                site = label[site]
            return site

        pull = dict.fromkeys(laboratory.spin, Decimal(0))
        for lower, upper, n, held, _, _ in laboratory.contacts():
            coefficient = held / laboratory.strength
            turn = tuple(a + b for a, b in zip(laboratory.spin[lower], laboratory.spin[upper], strict=True))
            across = tuple(part for part, along in zip(turn, n, strict=True) if along == 0)
            size = dot(across, across).sqrt()
            if n[component] != 0:
                continue
            if size < Decimal("1e-25"):
                label[root(lower)] = root(upper)
            else:
                for site in (lower, upper):
                    pull[site] += coefficient * turn[component] / size
        total = {}
        for site, value in pull.items():
            total[root(site)] = total.get(root(site), Decimal(0)) + laboratory.parity(site) * value
        driven = {root(site) for site in laboratory.spin if laboratory.is_driven(site)}
        free = [abs(value) for domain, value in total.items() if domain not in driven]
        assert all(value < Decimal("1e-26") for value in free)
