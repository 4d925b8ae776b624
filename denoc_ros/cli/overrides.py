"""`--set` and `--payload`: dotted paths of the model."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from denoc_ros.cli.arguments import named_values, require
from denoc_ros.cli.path_settings import parse_setting


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Declare `--set` and `--payload`."""
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='PATH=VALUE',
        help='change a number of the model, such as beam.upper_arm.y.ei=9e4; repeatable',
    )
    parser.add_argument(
        '--payload',
        action='append',
        default=[],
        metavar='LINK=MASS[,X,Y,Z]',
        help='add a mass [kg] to a link, with its centre in the link frame [m]; repeatable',
    )


def overrides_of(settings: Sequence[str], payloads: Sequence[str]) -> dict[str, Any]:
    """Return overrides by dotted path.

    Parameters
    ----------
    settings : sequence of str
        `path=value` each.
    payloads : sequence of str
        `link=mass` or `link=mass,x,y,z` each.

    Raises
    ------
    ConfigError
        With every text that is neither.
    """
    findings: list[str] = []
    overrides: dict[str, Any] = {}
    for setting in settings:
        if (parsed := parse_setting(setting, findings)) is not None:
            overrides['.'.join(parsed[0])] = parsed[1]
    form = 'LINK=MASS or LINK=MASS,X,Y,Z'
    hung = named_values('--payload', payloads, form, _mass_and_centre, findings)
    require(findings)
    for link, (mass, *centre) in hung.items():
        overrides[f'payload.{link}.mass'] = mass
        if centre:
            overrides[f'payload.{link}.com'] = centre
    return overrides


def _mass_and_centre(text: str) -> list[float]:
    """Return MASS or MASS,X,Y,Z as numbers; ValueError for another text."""
    values = [float(number) for number in text.split(',')]
    if len(values) not in (1, 4):
        raise ValueError(text)
    return values
