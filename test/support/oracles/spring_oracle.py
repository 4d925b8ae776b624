"""Elastic joints on top of the dense oracle: a chain seen from its links, and a motor per joint.

Nothing is taken from the model's own springs: a description is split into the robot without
springs (test/support/oracles/oracles.py) and the numbers of its springs, and the equations of
both, in x = q + s and q, are written out densely.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np
from oracles import SLIDE_SPEED, Oracle
from strategies import Seeded, robot_text

from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.types import Array

GRAVITY = (0.7, -1.3, -9.6)


@dataclass
class Elastic:
    """What stands at an elastic joint, by the file."""

    stiffness: float
    damping: float
    stiffness3: float
    backlash: float
    motor: dict[str, float] = field(default_factory=dict)  # armature, damping, friction

    def wind_up(self, s: float) -> float:
        """Deflection of the spring beyond its play."""
        if self.backlash == 0.0:
            return s
        p, w = self.backlash / 2, self.backlash / 20
        return float(w * (np.logaddexp(0, (s - p) / w) - np.logaddexp(0, (-s - p) / w)))

    def energy(self, s: float) -> float:
        e = self.wind_up(s)
        return self.stiffness * e**2 / 2 + self.stiffness3 * e**4 / 4

    def force(self, s: float, rate: float) -> float:
        """Gradient of the energy, by central differences of order 6, and damping."""
        h = 1e-2 * (self.backlash / 20 if self.backlash else 1.0)
        steps = (1, 2, 3), (3 / 4, -3 / 20, 1 / 60)
        slope = sum(
            c * (self.energy(s + m * h) - self.energy(s - m * h))
            for m, c in zip(*steps, strict=True)
        )
        return slope / h + self.damping * rate


class SpringOracle:
    """The verbs of a robot with elastic joints, dense."""

    def __init__(self, text: str, gravity: tuple[float, float, float] = GRAVITY) -> None:
        self.springs, plain = split(text)
        self.chain = Oracle(load_tree(plain), gravity)
        self.names: list[str] = []
        rows: list[tuple[int, int]] = []  # of the matrix that gives x
        column = 0
        for body, span in zip(self.chain.tree.bodies, self.chain.spans, strict=True):
            if span.joint.stop > span.joint.start:
                assert body.joint is not None
                elastic = body.joint.name in self.springs
                self.names += [body.joint.name] + [f'{body.joint.name}/spring'] * elastic
                rows += [(span.joint.start, column + k) for k in range(1 + elastic)]
                column += 1 + elastic
            modes = [*range(span.y.start, span.torsion.stop)]
            rows += [(mode, column + k) for k, mode in enumerate(modes)]
            self.names += [''] * len(modes)
            column += len(modes)
        self.n = column
        self.see = np.zeros((self.chain.n, column))
        self.see[tuple(np.array(rows).T)] = 1.0

    def places(self) -> dict[str, int]:
        """Index of the motor's coordinate of each elastic joint."""
        return {name: self.names.index(name) for name in self.springs}

    def inverse_dynamics(self, q: Array, qd: Array, qdd: Array) -> Array:
        see = self.see
        tau = see.T @ self.chain.inverse_dynamics(see @ q, see @ qd, see @ qdd)
        for name, at in self.places().items():
            spring = self.springs[name]
            motor = spring.motor
            tau[at] += motor['armature'] * qdd[at] + motor['damping'] * qd[at]
            tau[at] += motor['friction'] * np.tanh(qd[at] / SLIDE_SPEED)
            tau[at + 1] += spring.force(q[at + 1], qd[at + 1])
        return np.asarray(tau)

    def inertia_matrix(self, q: Array) -> Array:
        total = self.see.T @ self.chain.inertia_matrix(self.see @ q) @ self.see
        for name, at in self.places().items():
            total[at, at] += self.springs[name].motor['armature']
        return np.asarray(total)

    def energy(self, q: Array, qd: Array) -> Array:
        kinetic, potential = self.chain.energy(self.see @ q, self.see @ qd)
        for name, at in self.places().items():
            kinetic += self.springs[name].motor['armature'] * qd[at] ** 2 / 2
            potential += self.springs[name].energy(q[at + 1])
        return np.array([kinetic, potential])


def split(text: str) -> tuple[dict[str, Elastic], str]:
    """Springs by joint, and the description without them and without their motors' terms."""
    root = ElementTree.fromstring(text)
    block = root.find('flexibility')
    assert block is not None
    springs = {}
    for element in block.findall('spring'):
        names = ('stiffness', 'damping', 'stiffness3', 'backlash')
        stiffness, *others = (float(element.get(name, 0)) for name in names)
        springs[element.attrib['joint']] = Elastic(stiffness, others[0], others[1], others[2])
        block.remove(element)
    for element in block.findall('actuator'):
        if element.get('joint') in springs:
            springs[element.attrib['joint']].motor['armature'] = float(element.attrib['armature'])
            block.remove(element)
    for joint in root.findall('joint'):
        if joint.get('name') in springs:
            dynamics = joint.find('dynamics')
            given = {} if dynamics is None else dynamics.attrib
            for name in ('damping', 'friction'):
                springs[joint.attrib['name']].motor[name] = float(given.get(name, 0))
            if dynamics is not None:
                joint.remove(dynamics)
    return springs, ElementTree.tostring(root, encoding='unicode')


def elastic_robot(seed: int, links: int = 4, conservative: bool = False) -> str:
    """Random flexible robot with springs on about two of three joints, from a seed."""
    source = Seeded(np.random.default_rng(seed))
    root = ElementTree.fromstring(robot_text(source, links))
    block = root.find('flexibility')
    assert block is not None
    movable = [joint for joint in root.findall('joint') if joint.get('type') != 'fixed']
    for k, joint in enumerate(movable):
        if k and source.integer(0, 2) == 0:
            continue
        name = joint.attrib['name']
        for element in block.findall('actuator'):
            if element.get('joint') == name:
                block.remove(element)
        given = {'joint': name, 'stiffness': repr(10 ** source.number(2.0, 4.0))}
        if not conservative:
            given['damping'] = repr(source.number(0.0, 5.0))
        if source.integer(0, 1):
            given['stiffness3'] = repr(10 ** source.number(3.0, 5.0))
        if source.integer(0, 1):
            given['backlash'] = repr(source.number(0.005, 0.05))
        ElementTree.SubElement(block, 'spring', given)
        armature = repr(source.number(0.05, 1.0))
        ElementTree.SubElement(block, 'actuator', joint=name, armature=armature)
    return ElementTree.tostring(root, encoding='unicode')
