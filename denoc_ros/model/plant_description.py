"""A plant described otherwise than its model: more modes, other shape functions, segments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from denoc_ros.model.beams.segments import damping_ratios, deformations
from denoc_ros.model.beams.shapes import SHAPES
from denoc_ros.model.reading.flexibility import MOST_MODES, MOST_SEGMENTS
from denoc_ros.model.tree import Beam, Tree

KEYS = ('modes', 'shape', 'segments')
LIMITS = {'modes': MOST_MODES, 'segments': MOST_SEGMENTS}


@dataclass(frozen=True)
class PlantDescription:
    """How every beam of a plant is described, where that differs from the robot's file."""

    # of each bending plane and of torsion, per segment; 0: as in the file. What the file takes as
    # rigid stays rigid. Further modes are damped as the file's last.
    modes: int = 0
    # shape functions of bending; '': as in the file, and Craig-Bampton where beams are divided
    shape: str = ''
    segments: int = 0  # per beam; 0: as in the file

    def __bool__(self) -> bool:
        """Whether it says anything."""
        return self != PlantDescription()

    def overrides(self, tree: Tree) -> dict[str, Any]:
        """Return the dotted paths, and their values, by which a robot becomes the plant."""
        found: dict[str, Any] = {}
        for body in tree.bodies:
            if body.beam is None or body.segment > 1:
                continue
            if self.segments:
                found[f'beam.{body.name}.segments'] = self.segments
            if self.shape:
                found[f'beam.{body.name}.shape'] = self.shape
            found.update(self._deformations(f'beam.{body.name}', body.beam))
        return found

    def _deformations(self, path: str, beam: Beam) -> dict[str, Any]:
        """Return modes and damping ratios of a beam whose count of modes changes."""
        found: dict[str, Any] = {}
        for name, part, critical in deformations(beam):
            modes, segments = self.modes or part.modes, self.segments or beam.segments
            if not part.modes or (modes, segments) == (part.modes, beam.segments):
                continue
            ratios = damping_ratios(part.damping, critical)
            ratios = ratios[:1] if segments > 1 else (ratios + ratios[-1:] * modes)[:modes]
            found[f'{path}.{name}.modes'] = modes
            found[f'{path}.{name}.damping_ratio'] = ratios
        return found


def read_plant(values: Mapping[str, Any], find: Callable[[str], None]) -> PlantDescription:
    """Return the description in a mapping that may hold other keys; `find` takes each finding."""
    read: dict[str, Any] = {}
    for key, most in LIMITS.items():
        value = values.get(key, 0)
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most:
            read[key] = value
        else:
            rule = f'must be a whole number from 0 (as in the file) to {most}'
            find(f'plant {key} {rule}, got {value!r}')
    shape = values.get('shape', '')
    if shape in ('', *SHAPES):
        read['shape'] = shape
    else:
        find(f'plant shape must be one of {", ".join(SHAPES)}, got {shape!r}')
    return PlantDescription(**read)


def description_in_words(tree: Tree) -> str:
    """Return how a robot's beams are described, such as `craig-bampton, 2 modes`."""
    found: dict[str, None] = {}
    for body in tree.bodies:
        if body.beam is not None and body.segment <= 1:
            found[_beam_in_words(body.beam)] = None
        if body.modes is not None:
            found[f'{body.modes.count} component modes'] = None
    return '; '.join(found) or 'rigid links'


def _beam_in_words(beam: Beam) -> str:
    if beam.segments > 1:
        return f'{beam.segments} segments per beam'
    for name, part in (('', beam.y), ('', beam.z), ('torsion', beam.torsion)):
        if part is not None and part.modes:
            return f'{name or part.shape}, {part.modes} mode{"s" * (part.modes != 1)}'
    return 'rigid'
