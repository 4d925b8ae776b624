"""What is no XML of a robot, or abuses XML, is refused before it is read."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from denoc_ros.errors import ModelError
from denoc_ros.model.overrides import edited_description
from denoc_ros.model.reading.source import LARGEST_TEXT
from denoc_ros.model.reading.urdf import load_tree

Spoil = Callable[[str, str], str]

BILLION_LAUGHS = """<?xml version="1.0"?>
<!DOCTYPE robot [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;"><!ENTITY d "&c;&c;&c;&c;&c;&c;&c;&c;">]>
<robot name="&d;"><link name="base"/></robot>"""
EXTERNAL = """<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]>
<robot name="a"><link name="base"/>&x;</robot>"""
IMPOSSIBLE = """<inertial><mass value="1"/>
<inertia ixx="1" ixy="2" ixz="0" iyy="1" iyz="0" izz="2"/></inertial>"""


def test_an_undeclared_prefix_of_what_is_not_read_is_kept(arm_text: str) -> None:
    more = '<gazebo reference="tool"><sensor:camera name="c" far:at="1"/></gazebo>'
    text = arm_text.replace('<flexibility>', f'{more}<flexibility>')
    one, other = load_tree(text), load_tree(arm_text)
    assert [body.name for body in one.bodies] == [body.name for body in other.bodies]
    edited = edited_description(text, {'joint.shoulder.damping': 3.0})
    assert more in edited
    assert load_tree(edited).joints['shoulder'].damping == 3.0


@pytest.mark.parametrize('bomb', [BILLION_LAUGHS, EXTERNAL, '<!ENTITY a "b"><robot/>'])
def test_entities_are_refused_before_any_parser(bomb: str) -> None:
    with pytest.raises(ModelError, match='the XML must have no DOCTYPE and no entities'):
        load_tree(bomb)


def test_a_doctype_in_another_encoding_is_refused(tmp_path: Path) -> None:
    path = tmp_path / 'hidden.urdf'
    path.write_bytes(EXTERNAL.encode('utf-16'))
    with pytest.raises(ModelError, match='UTF-8'):
        load_tree(path)
    declared = '<?xml version="1.0" encoding="UTF-7"?>+ADw-!DOCTYPE robot+AD4-<robot name="a"/>'
    with pytest.raises(ModelError, match='must be well-formed'):
        load_tree(declared)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('<robot name="a"><link name="b"></robot>', 'the XML must be well-formed, got: '),
        ('<robot name="a"/>', 'robot: links must be at least one, got none'),
        (
            '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="l"/>'
            '<xacro:include filename="b"/></robot>',
            'xacro must be expanded first: xacro FILE.xacro > FILE.urdf, got <xacro:include>',
        ),
        (
            '<robot name="a"><link name="l"/><xacro:include filename="b"/></robot>',
            'xacro must be expanded first: xacro FILE.xacro > FILE.urdf, got <xacro:include>',
        ),
        *(
            (f'<robot name="a">{part}</robot>', 'well-formed, got: Namespace prefix far')
            for part in (
                '<link name="l"><far:mass/></link>',
                '<link name="l"><inertial far:mass="1"/></link>',
                '<link name="l"/><flexibility><far:beam/></flexibility>',
            )
        ),
        ('<robot name="a"><gazebo><far:a>&b;</far:a></gazebo></robot>', 'well-formed'),
        ('<robot name="a"><gazebo><far:a></far:b></gazebo></robot>', 'well-formed'),
        ('<sdf name="a"/>', 'the root element must be <robot>, got <sdf>'),
        ('<robot name="a">\0</robot>', 'the XML must be well-formed'),
        ('<' * 100, 'the XML must be well-formed'),
    ],
)
def test_malformed_text_is_refused(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load_tree(text)


def test_an_error_names_the_file(tmp_path: Path, spoiled: Spoil) -> None:
    path = tmp_path / 'arm.urdf'
    path.write_text(spoiled('ei="1.0e5"', 'ei="-3.2"'))
    with pytest.raises(ModelError, match=r"arm\.urdf: beam 'upper_arm': ei"):
        load_tree(path)
    with pytest.raises(ModelError, match='the file must be readable, got: No such file'):
        load_tree(tmp_path / 'none.urdf')
    with pytest.raises(ModelError, match='the file must be readable, got: Is a directory'):
        load_tree(str(tmp_path))


def test_a_huge_file_is_refused_without_reading_it_all(tmp_path: Path) -> None:
    path = tmp_path / 'huge.urdf'
    with path.open('wb') as file:
        file.write(b'<robot name="a">')
        file.truncate(1 << 36)
    start = time.monotonic()
    with pytest.raises(ModelError, match=f'at most {LARGEST_TEXT} bytes'):
        load_tree(path)
    assert time.monotonic() - start < 10.0


def test_deep_nesting_is_refused() -> None:
    deep = '<robot name="a">' + '<link>' * 100000 + '</link>' * 100000 + '</robot>'
    with pytest.raises(ModelError, match='must be well-formed'):
        load_tree(deep)


def test_an_attribute_in_other_letters_spoils_none_of_the_rest(
    caplog: pytest.LogCaptureFixture, spoiled: Spoil
) -> None:
    plain = load_tree(spoiled('effort="10"', 'effort="10"'))
    other = load_tree(spoiled('effort="10"', 'größe="1" effort="10"'))
    for tree in (plain, other):
        assert [b.joint.limits.effort for b in tree.bodies if b.joint] == [10.0, 10.0]
    assert not caplog.records  # yourdfpy tells when it mends a text


def test_an_inertia_that_no_body_has_is_warned_of(spoiled: Spoil) -> None:
    bent = spoiled('<link name="base"/>', f'<link name="base">{IMPOSSIBLE}</link>')
    (warning,) = load_tree(bent).warnings
    assert warning == (
        "link 'base': principal moments of <inertia> should be >= 0 kg m^2, got -1, 2, 3"
    )
