"""Materials of links: elasticity, density and known damping."""

from __future__ import annotations

from dataclasses import dataclass

HANDBOOK = 'MIL-HDBK-5J, design values at room temperature'
LAMINATE = 'Tsai & Hahn, Introduction to Composite Materials, 1980'
BARE = 'Cremer & Heckl, Structure-Borne Sound'
JOINTED = 'Adams & Askenazi, Building Better Products with Finite Element Analysis'


@dataclass(frozen=True)
class Material:
    """A material by name."""

    name: str  # as on the command line
    grade: str  # what the numbers are those of
    # Young's and shear modulus [Pa]; a laminate's in its plane
    e: float
    g: float
    density: float  # [kg/m^3]
    source: str  # where the numbers come from
    # damping ratio of a bare piece, which no link falls below; None: not known
    bare_damping: float | None = None

    @property
    def damping_text(self) -> str:
        """Range of the assumed damping ratio, with its sources."""
        bare = 'that' if self.bare_damping is None else f'{self.bare_damping:g}'
        return f'{bare} of a bare piece ({BARE}) and {JOINTED_DAMPING:g} with joints ({JOINTED})'


CARBON = 'T300/5208 carbon-epoxy, quasi-isotropic'
GLASS = 'Scotchply 1002 glass-epoxy, quasi-isotropic'
MATERIALS = {
    material.name: material
    for material in (
        Material('aluminium', '6061-T6', 68.3e9, 26.2e9, 2710.0, HANDBOOK, 5e-5),
        Material('steel', 'AISI 4130', 200e9, 75.8e9, 7830.0, HANDBOOK, 1e-4),
        Material('titanium', 'Ti-6Al-4V', 110e9, 42.7e9, 4430.0, HANDBOOK),
        Material('magnesium', 'AZ31B', 44.8e9, 16.5e9, 1770.0, HANDBOOK, 5e-5),
        Material('cfrp', CARBON, 69.7e9, 26.9e9, 1600.0, LAMINATE),
        Material('gfrp', GLASS, 19.0e9, 7.47e9, 1800.0, LAMINATE),
    )
}

# A link's damping is that of its joints more than of its material; small motions of one piece stay
# far below the 0.02 to 0.04 that handbooks have for continuous metal structures.
ASSUMED_DAMPING = 0.005
JOINTED_DAMPING = 0.03
