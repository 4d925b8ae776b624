"""The same robot with its floating base held, for a base with a known motion."""

from __future__ import annotations

from lxml import etree

from denoc_ros.model.source import parse_xml


def with_held_base(text: str) -> str:
    """Return a description whose floating joint is fixed: the base of all that it carries.

    Parameters
    ----------
    text : str
        The description.

    Returns
    -------
    str
        The same text where no joint floats.
    """
    root = parse_xml('robot description', text, whole=True)
    for joint in root.findall('joint'):
        if joint.get('type') == 'floating':
            joint.set('type', 'fixed')
    return str(etree.tostring(root, encoding='unicode'))
