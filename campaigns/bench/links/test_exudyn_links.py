"""Short forms of the comparisons with Exudyn: meshed links, and beams with stations."""

from __future__ import annotations

from bench.links.exudyn_links import meshed, tapered


def test_meshed_links_move_as_floating_frames_of_the_same_modes() -> None:
    found = meshed(2e9, duration=0.1, step=2.5e-4)
    assert found.tip <= 1e-8
    assert found.deflection > 5e-5


def test_tapered_beams_with_a_step_fall_as_cable_elements_do() -> None:
    found = tapered(0.2, 32, 5e-4)
    assert found.tip <= 1e-5
    assert found.deflection > 2e-4
