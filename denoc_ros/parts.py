"""Optional parts of the package: what each adds to the core, by names of modules.

A part is a folder whose `PART` says what the part adds. The core imports no
part: it looks the modules of parts up here. A folder that is removed takes its verbs, nodes and
parameters with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

from denoc_ros.errors import ConfigError

PARTS = ('planning', 'feedback', 'identification', 'reduction', 'reports', 'viewer', 'export')


class Verb(NamedTuple):
    """A verb of `denoc`: its line of help, and its module below `denoc_ros`."""

    help: str
    module: str
    # the module with its `ACTIONS` and its `default_action`, of a verb that has actions
    actions: str = ''


class NodeModules(NamedTuple):
    """The modules of a node below `denoc_ros`: its `main`, and the `TABLE` of its parameters."""

    main: str
    parameters: str


@dataclass(frozen=True)
class OptionalPart:
    """What an optional part adds to the core; modules are named below `denoc_ros`.

    Attributes
    ----------
    needs : tuple of str
        Other parts without which this part does not work.
    names : mapping of str to str
        Module of each public Python name.
    verbs : mapping of str to Verb
        Verbs of `denoc`.
    nodes : mapping of str to NodeModules
        Nodes.
    jobs : mapping of str to str
        Module of each kind of job that the worker process does; it has `answer`.
    rows : mapping of str to str
        Module with `ROWS`, the parameters that the part adds to a node of the core.
    """

    needs: tuple[str, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    verbs: Mapping[str, Verb] = field(default_factory=dict)
    nodes: Mapping[str, NodeModules] = field(default_factory=dict)
    jobs: Mapping[str, str] = field(default_factory=dict)
    rows: Mapping[str, str] = field(default_factory=dict)


CORE_NODES = {
    name: NodeModules(f'nodes.{name}', f'runtime.parameters.{name}_parameters')
    for name in ('feedforward', 'predictor', 'recorder', 'plant')
}


@cache
def parts() -> dict[str, OptionalPart]:
    """Return the parts that are there, and whose needs are."""
    found: dict[str, OptionalPart] = {
        name: import_module(f'denoc_ros.{name}').PART
        for name in PARTS
        if find_spec(f'denoc_ros.{name}') is not None
    }
    return {name: part for name, part in found.items() if set(part.needs) <= set(found)}


def optional(module: str) -> Any:
    """Return a module of a part, named below `denoc_ros`; None where the part is not there."""
    is_there = module.partition('.')[0] in parts()
    return import_module(f'denoc_ros.{module}') if is_there else None


def required(module: str, where: str) -> Any:
    """Return a module of a part.

    Raises
    ------
    ConfigError
        The part is not there; `where` says what asked for it.
    """
    found = optional(module)
    if found is None:
        part = module.partition('.')[0]
        rule = f"denoc_ros must have its part '{part}', got an installation without it"
        raise ConfigError(where, [rule])
    return found


def nodes() -> dict[str, NodeModules]:
    """Return the modules of all nodes."""
    found = dict(CORE_NODES)
    for part in parts().values():
        found.update(part.nodes)
    return found


def node_main(node: str) -> str:
    """Return the full name of the module that runs a node."""
    return f'denoc_ros.{nodes()[node].main}'


def parameter_table(node: str) -> Any:
    """Return the table of the parameters of a node."""
    return import_module(f'denoc_ros.{nodes()[node].parameters}').TABLE


def added_rows(node: str) -> Iterator[Any]:
    """Yield the parameters that the parts add to a node of the core."""
    for part in parts().values():
        if node in part.rows:
            yield from import_module(f'denoc_ros.{part.rows[node]}').ROWS
