"""The parameters of each node of a session: checked against its table, written for ROS."""

from __future__ import annotations

from pathlib import Path

import yaml

from denoc_ros.cli.session.session_config import SIMULATED, Parameters, Phase, SessionConfig
from denoc_ros.errors import ConfigError
from denoc_ros.model.numbers import FAMILIES
from denoc_ros.model.plant_description import PlantDescription, read_plant
from denoc_ros.output_files import write_text
from denoc_ros.parts import parameter_table
from denoc_ros.runtime.parameters.parameter_table import ParameterTable

# the time stands until the session lets it go on; partners that are slow are waited for
LOCKSTEP: Parameters = {
    'clock': 'lockstep',
    'real_time_factor': 0.0,
    'pause_at': 0.0,
    'lockstep.timeout': 60.0,
}
PARTNERS = ('feedforward', 'predictor', 'shaper', 'recorder')


def node_table(name: str) -> ParameterTable:
    """Return the parameter table of a node."""
    table: ParameterTable = parameter_table(name)
    return table


def node_parameters(config: SessionConfig, name: str, phase: Phase, folder: Path) -> Parameters:
    """Return a node's parameters in a phase, each as the type its table says."""
    table = node_table(name)
    given: Parameters = {}
    if table.row('gravity') is not None:
        given['gravity'] = list(config.gravity)
        given.update(config.plant_model if name == 'plant' else config.model_in(phase))
    if name == 'recorder':
        given['output'] = str(folder / 'bag')
    given.update(config.nodes.get(name, {}))
    given.update(phase.nodes.get(name, {}))
    if config.time == SIMULATED and name == 'plant':
        others = session_partners(config)
        given = {**LOCKSTEP, 'lockstep.partners': others, **given}
    table.settings(given, f'{config.path}: {name}')
    accepted = {key: table.accept(key, value) for key, value in given.items()}
    return {**accepted, 'use_sim_time': True} if config.time == SIMULATED else accepted


def session_plant(config: SessionConfig) -> PlantDescription:
    """Return how the plant's beams are described in a session that has one of our engine."""
    plant = config.nodes.get('plant', {})
    if plant.get('engine') == 'mujoco':
        return PlantDescription()
    return read_plant(plant, lambda finding: None)


def plant_numbers(config: SessionConfig, phase: Phase) -> Parameters:
    """Return the numbers of the plant's robot that a session gives in a phase, by dotted path."""
    given = {**config.plant_model, **phase.nodes.get('plant', {})}
    return {path: value for path, value in given.items() if path.split('.')[0] in FAMILIES}


def session_partners(config: SessionConfig) -> list[str]:
    """Return the nodes that the time of a simulated session waits for."""
    left_out = set(config.without) if config.record else {*config.without, 'recorder'}
    return [name for name in PARTNERS if name not in left_out]


def check_parameters(config: SessionConfig, names: list[str]) -> None:
    """Raise ConfigError with the parameters that the nodes would refuse in any phase."""
    findings: dict[str, None] = {}
    for phase in config.phases:
        for name in names:
            try:
                node_parameters(config, name, phase, Path())
            except ConfigError as error:
                findings.update((f'{name}: {text}', None) for text in error.findings)
    ConfigError.raise_any(str(config.path), list(findings))


def changed_parameters(name: str, now: Parameters, wanted: Parameters) -> Parameters | None:
    """Parameters to set in a running node so that it has other ones; None where impossible.

    Parameters
    ----------
    now, wanted : mapping
        What it was given, what it shall have; a parameter that is not there has its default.

    Returns
    -------
    mapping or None
        None: one of them can be given at the start only, so the node must be started anew.
    """
    changed: Parameters = {}
    for key in (*wanted, *(key for key in now if key not in wanted)):
        row = node_table(name).row(key)
        default = None if row is None else row.default
        value = wanted.get(key, default)
        if value == now.get(key, default):
            continue
        if row is None or not row.live or value is None:
            return None
        changed[key] = value
    return changed


def write_parameters(file: Path, parameters: Parameters) -> None:
    """Write a params file for `--params-file`."""
    text = yaml.safe_dump({'/**': {'ros__parameters': parameters}}, sort_keys=True)
    write_text(file, text)
