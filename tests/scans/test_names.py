"""Names of samples: what shapes a result is in them, and nothing else."""

import pytest

from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.plan import sample_key


def names(*settings):
    return {sample_key(RunSettings(**given)) for given in settings}


def test_what_changes_a_result_changes_the_name():
    shapes = [{"shape": [10, 10]}, {"shape": [10, 11]}, {"shape": [10, 10], "seed": 3}, {"spin_bottom": 0.5}]
    methods = [{"method": name} for name in ("cundall-strack", "implicit-cundall-strack", "rigid-limit")]
    options = [{"method": "cundall-strack", key: 2.0} for key in ("stiffness", "damping", "mass", "static_ratio")]
    others = [{"law": "viscous"}, {"normal_force": 2.0}, {"slip_threshold": 1e-9}, {"tolerance": 1e-5}, {}]
    every = [*shapes, *methods, *options, *others]
    assert len(names(*every)) == len(every)


@pytest.mark.parametrize("idle", [{"threads": 3}, {"checkpoint_every": 5.0}, {"shape": [32] * 3}])
def test_what_changes_no_result_is_in_no_name(idle):
    """Nor are values equal to the defaults, so that a new option renames nothing."""
    assert names(idle) == names({})


def test_files_are_named_by_what_they_hold(tmp_path):
    import numpy as np

    for name, value in (("a", 0.5), ("b", 0.5), ("c", 0.25)):
        np.savez(tmp_path / f"{name}.npz", x=np.full((2, 3), value), y=np.full((3, 2), value))
    keys = [sample_key(RunSettings(shape=[3, 3], coefficients=str(tmp_path / f"{name}.npz"))) for name in "abc"]
    assert keys[0] == keys[1] != keys[2]
