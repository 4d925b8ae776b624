"""Real-time model-based control of robots with flexible links, by the DeNOC recursion.

The public names are loaded on first use, so that a command which needs none of them starts fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from denoc_ros.control.shape import shape_motion as shape_motion
    from denoc_ros.dynamics.base_motion import BaseMotion as BaseMotion
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
    from denoc_ros.estimation.parameter_tracker import ParameterTracker as ParameterTracker
    from denoc_ros.estimation.tracker_settings import TrackerSettings as TrackerSettings
    from denoc_ros.identification.fit import identify_modes as identify_modes
    from denoc_ros.identification.model.excitation import design_excitation as design_excitation
    from denoc_ros.identification.model.fit import identify_model as identify_model
    from denoc_ros.identification.model.sources import Recording as Recording
    from denoc_ros.model.suggest.suggestion import suggest_flexibility as suggest_flexibility
    from denoc_ros.replay.bag import replay_bag as replay_bag
    from denoc_ros.reports.run import report as report
    from denoc_ros.simulation.simulate import simulate as simulate

_HOME = {
    'BaseMotion': 'dynamics.base_motion',
    'Robot': 'dynamics.robot',
    'load_robot': 'dynamics.robot',
    'Stepper': 'dynamics.stepper',
    'replay_bag': 'replay.bag',
    'report': 'reports.run',
    'shape_motion': 'control.shape',
    'simulate': 'simulation.simulate',
    'identify_modes': 'identification.fit',
    'design_excitation': 'identification.model.excitation',
    'identify_model': 'identification.model.fit',
    'Recording': 'identification.model.sources',
    'ParameterTracker': 'estimation.parameter_tracker',
    'TrackerSettings': 'estimation.tracker_settings',
    'suggest_flexibility': 'model.suggest.suggestion',
    'BagError': 'errors',
    'ConfigError': 'errors',
    'DenocError': 'errors',
    'IdentificationError': 'errors',
    'ModelError': 'errors',
    'SolverError': 'errors',
    'StateError': 'errors',
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{_HOME[name]}'), name)


def __dir__() -> list[str]:
    return __all__
