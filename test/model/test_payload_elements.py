"""`<payload>` of a description, and the overrides of its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import denoc_ros as dn
from denoc_ros.errors import ModelError
from denoc_ros.model.overrides import edited_description, with_overrides
from denoc_ros.model.reading.source import parse_xml
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.runtime.live_model import LiveModel

Spoil = Callable[[str, str], str]

ROBOTS = Path(__file__).parents[2] / 'config' / 'robots'
SOURCES = [(ROBOTS / name).read_text() for name in ('canadarm.urdf', 'two_link_ff.urdf')]
LINKS = ['tool', 'link_1']
PLACES = list(zip(SOURCES, LINKS, strict=True))
INERTIA = [0.4, 0.01, -0.02, 0.5, 0.03, 0.6]
NUMBERS: list[dict[str, Any]] = [
    {'mass': 3.7},
    {'mass': 12.1, 'com': [0.1, -0.2, 0.3]},
    {'mass': 2.3, 'com': [0.1, -0.2, 0.3], 'inertia': INERTIA},
]


def element(link: str, **numbers: Any) -> str:
    texts = {name: ' '.join(str(x) for x in np.ravel(value)) for name, value in numbers.items()}
    attributes = ' '.join(f'{name}="{text}"' for name, text in texts.items())
    return f'<payload link="{link}" {attributes}/></flexibility>'


def carrying(source: str, link: str, **numbers: Any) -> str:
    assert '</flexibility>' in source
    return source.replace('</flexibility>', element(link, **numbers))


def paths(link: str, numbers: Mapping[str, Any]) -> dict[str, Any]:
    return {f'payload.{link}.{name}': value for name, value in numbers.items()}


def require_same(one: dn.Robot, other: dn.Robot) -> None:
    """Check that inertia matrix and gravity torque are equal, to 1e-15 of the largest."""
    at = np.random.default_rng(4).uniform(-0.3, 0.3, (5, one.n))
    zero = np.zeros_like(at)
    for found, wanted in (
        (one.inertia_matrix(at), other.inertia_matrix(at)),
        (one.inverse_dynamics(at, zero, zero), other.inverse_dynamics(at, zero, zero)),
    ):
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-15 * np.abs(wanted).max())


@pytest.mark.parametrize('numbers', NUMBERS)
@pytest.mark.parametrize(('source', 'link'), PLACES)
def test_a_payload_of_the_file_is_that_of_the_overrides(
    source: str, link: str, numbers: dict[str, Any]
) -> None:
    said = dn.load_robot(carrying(source, link, **numbers))
    changed = dn.load_robot(source).with_overrides(paths(link, numbers))
    assert said.tree.payloads.keys() == changed.tree.payloads.keys() == {link}
    require_same(said, changed)
    read_again = dn.Robot(with_overrides(source, paths(link, numbers)))
    require_same(said, read_again)


@pytest.mark.parametrize('numbers', NUMBERS)
@pytest.mark.parametrize(('source', 'link'), PLACES)
def test_an_edited_description_carries_the_payload_of_the_overrides(
    source: str, link: str, numbers: dict[str, Any]
) -> None:
    changed = dn.load_robot(source).with_overrides(paths(link, numbers))
    edited = edited_description(source, paths(link, numbers))
    require_same(dn.load_robot(edited), changed)
    assert edited_description(edited, paths(link, numbers)) == edited
    (found,) = parse_xml('edited', edited).findall('flexibility/payload')
    assert found.get('link') == link
    without = dn.load_robot(edited_description(edited, {f'payload.{link}.mass': 0.0}))
    assert without.tree.payloads[link].mass == 0.0


def test_an_edited_description_of_a_plain_urdf_gets_a_block() -> None:
    text = (
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1"/></inertial></link><joint name="j" type="revolute">'
        '<parent link="a"/><child link="b"/><limit effort="1" velocity="1"/></joint></robot>'
    )
    edited = edited_description(text, {'payload.b.mass': 0.5, 'payload.b.com': [0, 0.1, 0]})
    assert '<payload link="b" mass="0.5" com="0.0 0.1 0.0"/>' in edited
    changed = dn.load_robot(text).with_overrides(
        {'payload.b.mass': 0.5, 'payload.b.com': '0 .1 0'}
    )
    require_same(dn.load_robot(edited), changed)


@pytest.mark.parametrize('read_again', [False, True], ids=['numbers', 'description'])
def test_an_override_replaces_one_number_and_the_file_says_the_others(read_again: bool) -> None:
    source, link = SOURCES[0], LINKS[0]
    text = carrying(source, link, **NUMBERS[2])
    wanted = dn.load_robot(carrying(source, link, **NUMBERS[2] | {'mass': 9.0}))
    given = {f'payload.{link}.mass': 9.0}
    if read_again:
        found = dn.Robot(with_overrides(text, given))
    else:
        found = dn.load_robot(text).with_overrides(given)
    require_same(found, wanted)
    require_same(LiveModel(dn.load_robot(text)).robot(given), wanted)


def test_a_number_shows_the_payload_of_the_file_and_setting_it_changes_nothing() -> None:
    text = carrying(SOURCES[0], 'tool', **NUMBERS[2])
    robot = dn.load_robot(text)
    shown = LiveModel(robot).values({})
    assert {name: shown[f'payload.tool.{name}'] for name in NUMBERS[2]} == NUMBERS[2]
    own = {path: value for path, value in shown.items() if path.startswith('payload.')}
    require_same(robot.with_overrides(own), robot)
    assert robot.with_overrides({'payload.tool.mass': 0.5}).tree.payloads['tool'].mass == 0.5
    assert robot.tree.payloads['tool'].mass == NUMBERS[2]['mass']


def test_other_overrides_keep_the_payload_of_the_file() -> None:
    text = carrying(SOURCES[0], 'tool', **NUMBERS[1])
    link = next(body.name for body in load_tree(text).bodies if body.beam is not None)
    for change in ({f'beam.{link}.y.ei': 1.0e5}, {f'beam.{link}.segments': 2}):
        one = dn.load_robot(text).with_overrides(change)
        other = dn.load_robot(SOURCES[0]).with_overrides(change | paths('tool', NUMBERS[1]))
        require_same(one, other)


def test_a_set_load_adds_to_the_payload_of_the_model() -> None:
    robot = dn.load_robot(carrying(SOURCES[0], 'tool', **NUMBERS[2]))
    robot.set_payload('tool', 1.5, (0.2, 0.0, 0.0))
    modelled = robot.with_modelled_payloads()
    at = np.random.default_rng(4).uniform(-0.3, 0.3, (5, robot.n))
    wanted = robot.inertia_matrix(at)
    found = modelled.inertia_matrix(at)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12 * np.abs(wanted).max())
    assert modelled.tree.payloads['tool'].mass == pytest.approx(2.3 + 1.5, rel=1e-14)


@pytest.mark.parametrize(
    ('link', 'numbers', 'message'),
    [
        ('nowhere', {'mass': 1}, r"payload 'nowhere': link must be a link of the robot"),
        ('base', {'mass': 1}, "payload 'base': must be on a link that moves .* fixed to the base"),
        ('tool', {}, "payload 'tool': mass must be >= 0 kg, got nothing"),
        ('tool', {'mass': -1}, "payload 'tool': mass must be >= 0 kg, got -1"),
        ('tool', {'mass': 1, 'com': [1, 2]}, 'com must be three finite numbers'),
        ('tool', {'mass': 1, 'inertia': [1] * 9}, 'inertia must be 6 finite numbers'),
        (
            'tool',
            {'mass': 1, 'inertia': [0.1, 0, 0, 0.2, 0, 1.68]},
            r"payload 'tool': inertia must be .* got principal moments 0\.1, 0\.2, 1\.68 kg m\^2",
        ),
        (
            'tool',
            {'mass': 1, 'inertia': [-1, 0, 0, 1, 0, 1]},
            'must be symmetric positive semidefinite',
        ),
        ('tool', {'mass': 1, 'size': 2}, "must be one of link, mass, com, inertia, got 'size'"),
    ],
)
def test_a_bad_payload_is_a_finding(
    arm_text: str, link: str, numbers: dict[str, Any], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        load_tree(carrying(arm_text, link, **numbers))


def test_all_bad_payloads_come_at_once(arm_text: str) -> None:
    text = carrying(arm_text, 'tool', mass=1)
    text = carrying(carrying(text, 'tool', mass=2), 'nowhere', mass='heavy')
    with pytest.raises(ModelError) as caught:
        load_tree(text)
    assert len(caught.value.findings) == 3
    assert "payload 'tool': link must have one payload, got two" in caught.value.findings


def test_an_override_with_an_inertia_that_no_body_has_is_refused(arm_text: str) -> None:
    for inertia in ([0.1, 0, 0, 0.2, 0, 1.68], [1.0, 0, 0, 1.0, 0, -1.0]):
        for changed in (with_overrides, edited_description):
            with pytest.raises(
                ModelError, match="payload 'tool': inertia must be symmetric positive"
            ):
                changed(arm_text, {'payload.tool.inertia': inertia})
        with pytest.raises(ModelError, match="payload 'tool': inertia must be symmetric positive"):
            dn.load_robot(arm_text).with_overrides({'payload.tool.inertia': inertia})


def test_a_point_mass_far_away_is_a_body(arm_text: str) -> None:
    """Rounding of a large mass times its distance squared is no impossible inertia."""
    rounded = [1e-7, 0.0, 0.0, -1e-7, 0.0, 0.0]
    text = carrying(arm_text, 'tool', mass=1e5, com=[10.0, 0.0, 0.0], inertia=rounded)
    assert load_tree(text).payloads['tool'].mass == 1e5
