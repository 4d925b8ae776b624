"""Builders of small robots' descriptions for the model's tests."""

from __future__ import annotations

from denoc_ros.model.tree import Tree
from denoc_ros.model.urdf import load_tree

ROD = (
    '<inertial><origin xyz="1 0 0"/><mass value="3"/><inertia ixx="0" iyy="1" izz="1"/></inertial>'
)
BALL = '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial>'


def link(name: str, inertial: str = BALL) -> str:
    return f'<link name="{name}">{inertial}</link>'


def joint(name: str, parent: str, child: str, xyz: str = '0 0 0', kind: str = 'revolute') -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="0 0 1"/></joint>'
    )


def robot(*parts: str) -> Tree:
    return load_tree(f'<robot name="r">{"".join(parts)}</robot>')


def beam(name: str, length: float = 2.0, inner: str = '', attributes: str = '') -> str:
    bending = inner or '<bending direction="y" ei="100" modes="2"/>'
    return f'<beam link="{name}" length="{length}" {attributes}>{bending}</beam>'


def block(*parts: str) -> str:
    return f'<flexibility>{"".join(parts)}</flexibility>'


def body_index(tree: Tree, name: str) -> int:
    return [body.name for body in tree.bodies].index(name)
