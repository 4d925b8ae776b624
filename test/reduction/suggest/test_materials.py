"""Materials: elasticity fits together, laminates are those of their layers."""

from __future__ import annotations

from pathlib import Path

import pytest

from denoc_ros.reduction.suggest.materials import ASSUMED_DAMPING, JOINTED_DAMPING, MATERIALS

# E1, E2, G12 [GPa], nu12 of one layer: Tsai & Hahn's table of T300/5208 and Scotchply 1002
LAYERS = {'cfrp': (181.0, 10.3, 7.17, 0.28), 'gfrp': (38.6, 8.27, 4.14, 0.26)}


@pytest.mark.parametrize('name', LAYERS)
def test_quasi_isotropic_laminate_is_the_mean_of_its_layers(name: str) -> None:
    e1, e2, g12, nu12 = LAYERS[name]
    scale = 1.0 - nu12**2 * e2 / e1
    q11, q22, q12 = e1 / scale, e2 / scale, nu12 * e2 / scale
    along = (3.0 * q11 + 3.0 * q22 + 2.0 * q12 + 4.0 * g12) / 8.0
    across = (q11 + q22 + 6.0 * q12 - 4.0 * g12) / 8.0
    shear = (q11 + q22 - 2.0 * q12 + 4.0 * g12) / 8.0
    # the table has three digits
    assert MATERIALS[name].e == pytest.approx(1e9 * (along - across**2 / along), rel=5e-3)
    assert MATERIALS[name].g == pytest.approx(1e9 * shear, rel=5e-3)


@pytest.mark.parametrize('name', MATERIALS)
def test_poisson_ratio_is_that_of_a_solid(name: str) -> None:
    material = MATERIALS[name]
    assert 0.2 < material.e / (2.0 * material.g) - 1.0 < 0.4
    assert material.name == name
    assert (material.bare_damping or 0.0) < ASSUMED_DAMPING < JOINTED_DAMPING


def test_tutorial_s_table_is_this_one(repository: Path) -> None:
    page = (repository / 'docs' / 'tutorial_1_flexible_urdf.md').read_text(encoding='utf-8')
    for name, material in MATERIALS.items():
        numbers = f'{material.e / 1e9:.3g} | {material.g / 1e9:.3g} | {material.density:.0f}'
        assert f'| `{name}` | {material.grade} | {numbers} |' in page
