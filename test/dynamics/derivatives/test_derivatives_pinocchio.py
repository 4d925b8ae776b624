"""Derivatives of rigid robots against Pinocchio's on the same file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from test_rigid_limit_pinocchio import EXAMPLES, identity, peer_of, read, states, without_dynamics

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.types import Array

RELATIVE = 1e-9


def close(value: Array, expected: Array, relative: float) -> None:
    scale = max(float(np.abs(expected).max()), 1e-6)
    np.testing.assert_allclose(value, expected, rtol=0, atol=relative * scale)


@pytest.mark.parametrize('path', EXAMPLES, ids=identity)
def test_derivatives_equal_pinocchios(path: Path) -> None:
    text = without_dynamics(read(path))
    robot = load_robot(text)
    names = list(robot.joint_names)
    peer = peer_of(text, names)
    data, order = peer.model.createData(), np.ix_(peer.order, peer.order)
    q, qd, qdd = states(robot, seed=len(path.name))
    place, rate = peer.configuration(names, q), peer.spread(qd)
    theirs = pin.computeRNEADerivatives(peer.model, data, place, rate, peer.spread(qdd))
    by_q, by_rate, inertia = robot.inverse_dynamics_derivatives(q, qd, qdd)
    close(by_q, theirs[0][order], RELATIVE)
    close(by_rate, theirs[1][order], RELATIVE)
    close(inertia, robot.inertia_matrix(q), RELATIVE)
    # massless or nearly massless links leave the solution open to the condition's rounding
    slack = max(RELATIVE, 1e-14 * float(np.linalg.cond(inertia)))
    if slack > 1e-4:
        return
    tau = robot.inverse_dynamics(q, qd, qdd)
    theirs = pin.computeABADerivatives(peer.model, data, place, rate, peer.spread(tau))
    by_q, by_rate, inverse = robot.forward_dynamics_derivatives(q, qd, tau)
    close(by_q, theirs[0][order], slack)
    close(by_rate, theirs[1][order], slack)
    upper = np.triu(theirs[2])
    close(inverse, (upper + np.triu(upper, 1).T)[order], slack)
