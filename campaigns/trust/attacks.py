"""What a siege does, drawn from a seed: steps of one to three attacks at once, plain as JSON.

Each attack is a dictionary with `do` (what), `node` (to whom) and its own `seed`, from which all
else about it follows: a step can be done again alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters
from trust.adversary import Adversary, Special
from trust.sieges.siege_gauges import FAULTS

Attack = dict[str, Any]
Step = list[Attack]
WEIGHTS = {
    'messages': 30, 'huge': 4, 'trajectories': 3, 'requests': 26, 'transitions': 8, 'pause': 6,
    'end': 4, 'clock': 4, 'description': 4, 'socket': 4, 'files': 3, 'join': 3, 'topics': 3,
    'brake': 4, 'cache': 2,
}  # fmt: skip
# where there are gauges; where there is a shaper
OF_GAUGES = {'gauges': 12}
OF_SHAPERS = {'kill': 5, 'halt': 5, 'endless': 3}
SIGNALLING = ('pause', 'end', 'kill', 'halt', 'cache')
COUNTS, RATES = (1, 3, 20, 100, 400), (0.0, 100.0, 500.0, 2000.0)  # of messages; Hz, 0: at once
LONGEST = 2.0  # s of messages
LENGTHS = (2_000, 30_000, 300_000)  # elements of a huge message
DESCRIPTIONS = (
    'bytes', 'spoilt', 'spoilt', 'spoilt', 'empty', 'path', 'folder', 'fifo', 'bomb', 'huge',
)  # fmt: skip
ENDS = (['TERM'], ['INT'], ['HUP'], ['TERM', 'TERM'], ['INT', 'INT'], ['HUP', 'TERM'])
DAMAGES = ('truncate', 'empty', 'garbage', 'flip', 'remove')  # to files of compiled kernels
FILES = ('folder', 'file', 'truncate', 'overwrite')
PARAMETERS = 'rcl_interfaces/srv/'
# kinds of ParameterValue: bool, integer, double, string, bytes and arrays of these
TYPES = (*range(10), 10, 77, 255)
TRANSITIONS = (*range(9), 10, 30, 60, 99, 200, 255)
# replaced by the stage's own answers, or heard by its own witness: no attack speaks there
OWN = ('/diagnostics', '/rosout', '/parameter_events', '/robot_description', '/clock', '/bare')


@dataclass(frozen=True)
class Inventory:
    """What the nodes offer and hear, as the graph says, and the names that mean something."""

    services: dict[str, dict[str, str]]  # by node: name to type
    inputs: dict[str, dict[str, str]]
    parameters: dict[str, dict[str, ParameterValue]]  # as they are to be
    words: list[str]
    has_gauges: bool = False
    has_shaper: bool = False

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of all nodes."""
        return tuple(self.parameters)

    @property
    def weights(self) -> dict[str, int]:
        """How often each kind of attack is drawn."""
        of_gauges = OF_GAUGES if self.has_gauges else {}
        return {**WEIGHTS, **of_gauges, **(OF_SHAPERS if self.has_shaper else {})}


def discover(stage: Any) -> Inventory:
    """Return what the running nodes offer."""
    services, inputs, parameters = {}, {}, {}
    words = {*stage.scene.joints}
    for node in stage.scene.nodes:
        found = stage.node.get_service_names_and_types_by_node(node, '/')
        services[node] = {name: kinds[0] for name, kinds in sorted(found)}
        heard = stage.node.get_subscriber_names_and_types_by_node(node, '/')
        inputs[node] = {
            topic: kinds[0]
            for topic, kinds in sorted(heard)
            if topic.startswith('/siege/') or topic in stage.attacked
        }
        listed = stage.ask_again(
            f'/{node}/list_parameters', f'{PARAMETERS}ListParameters', ListParameters.Request()
        )
        # a recorder gets a new folder with each start
        names = sorted(set(listed.result.names) - {'output'})
        values = stage.ask_again(
            f'/{node}/get_parameters',
            f'{PARAMETERS}GetParameters',
            GetParameters.Request(names=names),
        )
        parameters[node] = dict(zip(names, values.values, strict=True))
        words.update(names)
    has_gauges, has_shaper = bool(stage.scene.gauges), 'shaper' in stage.scene.nodes
    return Inventory(services, inputs, parameters, sorted(words), has_gauges, has_shaper)


def adversary(seed: int, inventory: Inventory, node: str) -> Adversary:
    """Return who draws what is sent to a node."""
    names = sorted(inventory.parameters[node])

    def parameter(adversary: Adversary) -> Parameter:
        name = adversary.one_of(names) if adversary.chance(0.8) else adversary.text()
        return Parameter(name=name, value=adversary.message('rcl_interfaces/ParameterValue'))

    def value(adversary: Adversary) -> ParameterValue:
        made = ParameterValue(type=int(adversary.one_of(TYPES)))
        for attribute, kind in ParameterValue.get_fields_and_field_types().items():
            if attribute != 'type':
                setattr(made, attribute, adversary.value(kind))
        return made

    def transition(adversary: Adversary) -> Any:
        from lifecycle_msgs.msg import Transition

        return Transition(id=int(adversary.one_of(TRANSITIONS)), label=adversary.text())

    special: dict[str, Special] = {
        'rcl_interfaces/Parameter': parameter,
        'rcl_interfaces/ParameterValue': value,
        'lifecycle_msgs/Transition': transition,
    }
    return Adversary(np.random.default_rng(seed), inventory.words, special)


def draw_step(rng: np.random.Generator, inventory: Inventory, mortal: tuple[str, ...]) -> Step:
    """Return one step.

    Parameters
    ----------
    rng : Generator
    inventory : Inventory
    mortal : tuple of str
        Nodes that may be told to end.
    """
    count = int(rng.choice((1, 2, 3), p=(0.5, 0.3, 0.2)))
    step = [draw_attack(rng, inventory, mortal) for _ in range(count)]
    # nobody else speaks while a reference is held to what it was before a stop
    alone = [attack for attack in step if attack['do'] == 'brake']
    if alone:
        return alone[:1]
    # what stops a process and what ends it do not go together: nobody could say who hung
    signalled: set[str] = set()
    kept = []
    for attack in step:
        if attack['do'] in SIGNALLING:
            if attack['node'] in signalled:
                continue
            signalled.add(attack['node'])
        kept.append(attack)
    return kept


def draw_attack(rng: np.random.Generator, inventory: Inventory, mortal: tuple[str, ...]) -> Attack:
    """Return one attack."""

    def one_of(choices: Any) -> Any:
        return choices[int(rng.integers(len(choices)))]

    kinds = list(inventory.weights)
    shares = np.array(list(inventory.weights.values()), dtype=float)
    kind = kinds[int(rng.choice(len(kinds), p=shares / shares.sum()))]
    attack: Attack = {
        'do': kind,
        'node': one_of(inventory.nodes),
        'seed': int(rng.integers(1 << 31)),
    }
    if kind in ('messages', 'huge'):
        hearing = [node for node in inventory.nodes if inventory.inputs[node]]
        attack['node'] = 'feedforward' if rng.random() < 0.4 else one_of(hearing)
        inputs = inventory.inputs[attack['node']]
        attack['topic'] = one_of(sorted(inputs))
        attack['type'] = inputs[attack['topic']]
        if kind == 'huge':
            attack.update(length=one_of(LENGTHS), count=one_of((1, 3)), rate=2.0)
        else:
            attack.update(count=one_of(COUNTS), rate=one_of(RATES))
        attack['same'] = bool(rng.random() < 0.4)
        attack['instead'] = bool(rng.random() < 0.5)
        attack['second'] = bool(rng.random() < 0.1)
    elif kind == 'trajectories':
        attack.update(node='feedforward', points=one_of((2, 200, 2000)), rate=100.0)
        attack.update(count=one_of((10, 100, 200)), far=one_of((0.0, 1e4, 1e5, 1e6, 1e300)))
    elif kind == 'requests':
        services = inventory.services[attack['node']]
        attack['service'] = one_of(sorted(services))
        attack['type'] = services[attack['service']]
        attack['count'] = one_of((1, 1, 3, 20))
    elif kind == 'transitions':
        attack['ids'] = [one_of(TRANSITIONS) for _ in range(int(rng.integers(1, 5)))]
    elif kind == 'pause':
        attack['seconds'] = one_of((0.02, 0.1, 0.4, 1.5))
        attack['times'] = one_of((1, 1, 5))
    elif kind == 'end':
        attack['node'] = one_of(mortal)
        attack.update(signals=one_of(ENDS), gap=one_of((0.0, 0.02, 0.3)))
        attack['after'] = one_of((0.0, 0.1, 0.5))
    elif kind == 'clock':
        attack['count'] = one_of((3, 50))
    elif kind == 'description':
        attack.update(node=one_of(('feedforward', 'predictor', 'plant')))
        attack.update(what=one_of(DESCRIPTIONS), anew=bool(rng.random() < 0.3))
    elif kind == 'socket':
        attack.update(node='viewer', count=one_of((5, 50, 200)))
    elif kind == 'files':
        attack.update(node='recorder', what=one_of(FILES))
    elif kind == 'gauges':
        node = 'feedforward' if inventory.has_shaper else 'predictor'
        attack.update(node=node, what=one_of(FAULTS), seconds=one_of((0.05, 0.3, 2.5)))
    elif kind == 'kill':
        # of the feedforward only what designs its gains
        attack.update(node=one_of(('shaper', 'feedforward')), child=bool(rng.random() < 0.5))
        attack['child'] = attack['child'] or attack['node'] == 'feedforward'
    elif kind == 'halt':
        attack.update(node=one_of(('shaper', 'feedforward')), seconds=one_of((0.05, 0.5, 3.0)))
        attack['then'] = one_of(('continue', 'kill', 'stop the node'))
    elif kind == 'endless':
        attack.update(
            node='shaper', seconds=one_of((3e4, 1e6, 2e9)), stop=bool(rng.random() < 0.5)
        )
    elif kind == 'brake':
        node = one_of(('shaper', 'shaper', 'feedforward') if inventory.has_shaper else
                      ('feedforward',))  # fmt: skip
        attack.update(node=node, how=one_of(('stop', 'cancel')), again=bool(rng.random() < 0.5))
        attack['after'] = one_of((0.0, 0.1, 0.4, 0.9))
    elif kind == 'cache':
        attack.update(node=one_of(mortal), what=one_of(DAMAGES), count=one_of((1, 3)))
        attack.update(signals=['TERM'], gap=0.0, after=0.0)
    elif kind == 'topics':
        attack.update(node='recorder', count=one_of((3, 20)))
    return attack
