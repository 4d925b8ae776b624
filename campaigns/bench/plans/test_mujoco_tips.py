"""A tip-exact plan of the Canadarm in MuJoCo: the short form of `python -m campaigns tips`."""

from __future__ import annotations

from bench.plans.mujoco_tips import carried_out, cases, plan_of


def test_the_canadarm_s_tip_stays_where_it_was_asked_to_be() -> None:
    case = cases()[0]
    robot = case.robot()
    plan, times, rows = plan_of(case, robot)
    alone = carried_out(robot, plan, times, rows, by_torque=True, segments=8)
    assert alone.moving < 1e-3
    assert alone.after < 3e-3
    held = carried_out(robot, plan, times, rows, by_torque=False, segments=8)
    assert held.moving < 1e-3
    assert held.after < 1e-3
