"""Real-time model-based control of robots with flexible links, by the DeNOC recursion.

The public names are loaded on first use, so that a command which needs none of them starts fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from denoc_ros.dynamics.base.base_motion import BaseMotion as BaseMotion
    from denoc_ros.dynamics.robot import Robot as Robot
    from denoc_ros.dynamics.robot import load_robot as load_robot
    from denoc_ros.dynamics.stepper import Stepper as Stepper
    from denoc_ros.errors import BagError as BagError
    from denoc_ros.errors import ConfigError as ConfigError
    from denoc_ros.errors import DenocError as DenocError
    from denoc_ros.errors import IdentificationError as IdentificationError
    from denoc_ros.errors import ModelError as ModelError
    from denoc_ros.errors import SolverError as SolverError
    from denoc_ros.errors import StateError as StateError
    from denoc_ros.identification.decay.modes_fit import identify_modes as identify_modes
    from denoc_ros.identification.model.excitation import design_excitation as design_excitation
    from denoc_ros.identification.model.model_fit import identify_model as identify_model
    from denoc_ros.identification.model.sources import Recording as Recording
    from denoc_ros.identification.run_numbers import identify as identify
    from denoc_ros.identification.tracking.parameter_tracker import (
        ParameterTracker as ParameterTracker,
    )
    from denoc_ros.identification.tracking.tracker_settings import (
        TrackerSettings as TrackerSettings,
    )
    from denoc_ros.planning.shape_motion import shape_motion as shape_motion
    from denoc_ros.reduction.suggest.suggestion import suggest_flexibility as suggest_flexibility
    from denoc_ros.reports.run_page import report as report
    from denoc_ros.simulation.recorded.replay_bag import replay as replay
    from denoc_ros.simulation.recorded.replay_bag import replay_bag as replay_bag
    from denoc_ros.simulation.simulate import simulate as simulate

_CORE = {
    'BaseMotion': 'dynamics.base.base_motion',
    'Robot': 'dynamics.robot',
    'load_robot': 'dynamics.robot',
    'Stepper': 'dynamics.stepper',
    'replay': 'simulation.recorded.replay_bag',
    'replay_bag': 'simulation.recorded.replay_bag',
    'simulate': 'simulation.simulate',
    'BagError': 'errors',
    'ConfigError': 'errors',
    'DenocError': 'errors',
    'IdentificationError': 'errors',
    'ModelError': 'errors',
    'SolverError': 'errors',
    'StateError': 'errors',
}


def _homes() -> dict[str, str]:
    """Return the module of each public name: of the core, then of the parts that are there."""
    from denoc_ros.parts import parts

    found = dict(_CORE)
    for part in parts().values():
        found.update(part.names)
    return found


def __getattr__(name: str) -> Any:
    home = _CORE.get(name)
    if home is None and not name.startswith('_'):
        home = _homes().get(name)
    if name == '__all__':
        return __dir__()
    if home is None:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{home}'), name)


def __dir__() -> list[str]:
    return sorted(_homes())
