import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.scene.disorder import Distribution, draw_coefficients


def test_the_seed_convention_is_one_uniform_draw_an_axis():
    rng = np.random.default_rng(12)
    expected = [rng.uniform(0.1, 1.0, shape) for shape in ((2, 4, 5), (3, 3, 5), (3, 4, 4))]
    drawn = draw_coefficients(Lattice((3, 4, 5)), Distribution.parse("uniform:0.1,1.0"), 12)
    assert all((a == b).all() for a, b in zip(drawn, expected, strict=True))


@pytest.mark.parametrize(
    ("text", "mean"),
    [
        ("uniform:0.1,1.0", 0.55),
        ("lognormal:0.5,0.3", 0.5 * np.exp(0.045)),
        ("power-law:0.1,1.0,-1", 0.9 / np.log(10)),
        ("power-law:0.1,1.0,2", 3 / 4 * (1 - 1e-4) / (1 - 1e-3)),
        ("bimodal:0.1,0.9,0.25", 0.3),
        ("constant:0.4", 0.4),
    ],
)
def test_distributions_have_their_mean(text, mean):
    values = Distribution.parse(text)(np.random.default_rng(3), (200_000,))
    assert values.mean() == pytest.approx(mean, abs=5 * values.std() / np.sqrt(len(values)) + 1e-12)
    assert (values > 0).all()
    assert str(Distribution.parse(str(Distribution.parse(text)))) == str(Distribution.parse(text))


@pytest.mark.parametrize(
    "text",
    ["gauss:0,1", "uniform:1", "uniform:a,b", "uniform:-1,1", "uniform:0,1", "uniform:2,1", "constant:nan",
     "bimodal:0.1,1,1.5", "lognormal:1,-1", "uniform", "constant:inf"],
)  # fmt: skip
def test_nonsense_distributions_are_refused(text):
    with pytest.raises(InputError):
        Distribution.parse(text)
