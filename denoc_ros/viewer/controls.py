"""The controls of a page: drawn parts, scale of the deflection, colour scale."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from denoc_ros.viewer.bending import PRESSED, STILL, STRETCHED
from denoc_ros.viewer.overlays import REACTION, REACTION_MOMENT, TORQUE
from denoc_ros.viewer.view import Legend, ViewOptions

LARGEST = 100.0  # deflection scale


class Controls:
    """Slider, toggles and legend.

    Parameters
    ----------
    gui : viser's gui
    look : ViewOptions
        To start with.
    changed : callable
        Called, in a thread of viser's, when the user changes something.
    """

    def __init__(self, gui: Any, look: ViewOptions, changed: Callable[[], None]) -> None:
        with gui.add_folder('Deflection', order=10.0):
            scale = min(max(look.scale, 1.0), LARGEST)
            self._scale = gui.add_slider(
                'Scale',
                1.0,
                LARGEST,
                0.5,
                scale,
                hint='Factor that enlarges the drawn deflections',
            )
            self._strain = gui.add_checkbox('Colour by strain', look.strain)
            self._ghost = gui.add_checkbox('Undeflected ghost', look.ghost)
            self._legend = gui.add_html('')
        with gui.add_folder('Forces', order=20.0):
            self._torques = gui.add_checkbox('Joint torques', look.torques)
            self._reactions = gui.add_checkbox('Reactions', look.reactions)
            self._loops = gui.add_checkbox('Loop joints', look.loops)
            self._arrows = gui.add_html('')
        for handle in (
            self._scale,
            self._strain,
            self._ghost,
            self._torques,
            self._reactions,
            self._loops,
        ):
            handle.on_update(lambda _: changed())

    @property
    def look(self) -> ViewOptions:
        """View options that the user has chosen."""
        return ViewOptions(
            float(self._scale.value),
            self._strain.value,
            self._ghost.value,
            self._torques.value,
            self._reactions.value,
            self._loops.value,
        )

    def explain(self, legend: Legend) -> None:
        """Explain the colours and arrows."""
        _put(self._legend, _colour_bar(legend.strain) if legend.strain else '')
        lines = [
            _key(colour, text.format(value))
            for colour, text, value in (
                (TORQUE, 'torque, longest {:.3g} N m (N)', legend.torque),
                (REACTION, 'force, longest {:.3g} N', legend.force),
                (REACTION_MOMENT, 'moment, longest {:.3g} N m', legend.moment),
            )
            if value
        ]
        if legend.held:
            lines.append('<div>no torques are known: reactions are those of held joints</div>')
        _put(self._arrows, _box(''.join(lines)) if lines else '')


def _put(handle: Any, text: str) -> None:
    if handle.content != text:
        handle.content = text


def _css(colour: tuple[int, int, int]) -> str:
    return f'rgb{colour}'


def _box(inner: str) -> str:
    return f'<div style="padding:0.2em 0.8em 0.5em;font-size:0.8em">{inner}</div>'


def _colour_bar(limit: float) -> str:
    ends = f'{limit * 1e6:g}'
    bar = (
        f'<div style="height:0.8em;border-radius:3px;background:linear-gradient(to right,'
        f'{_css(PRESSED)},{_css(STILL)},{_css(STRETCHED)})"></div>'
    )
    row = '<div style="display:flex;justify-content:space-between">{}</div>'
    numbers = ''.join(f'<span>{text}</span>' for text in (f'−{ends}', '0', f'+{ends}'))
    return _box('bending strain [µm/m]' + bar + row.format(numbers))


def _key(colour: tuple[int, int, int], text: str) -> str:
    return f'<div><span style="color:{_css(colour)}">➜</span> {text}</div>'
