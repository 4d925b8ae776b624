"""Inputs that are stale or missing: why a reference may not be followed."""

from __future__ import annotations

import math

from denoc_ros.runtime.parameters.parameter_table import Settings

NO_JOINTS, STALE_JOINTS = 'no joint_states yet', 'stale joint_states'


class FollowingConditions:
    """Says why a reference may not be followed.

    Parameters
    ----------
    from_joints : bool
        Whether the reference is the measured motion itself.

    Attributes
    ----------
    enabled, stopped : bool
        What was asked for by services.
    reference_timeout, lead : float
        s, as the parameters say.
    """

    def __init__(self, settings: Settings, from_joints: bool) -> None:
        self.enabled = settings.flag('enabled')
        self.stopped = False
        self._from_joints = from_joints
        self.update(settings)

    def update(self, settings: Settings) -> None:
        """Store the settings that the loop reads each tick."""
        self.reference_timeout = settings.number('reference_timeout')
        self.lead = settings.number('lead_time')
        self._joint_timeout = settings.number('joint_state_timeout')
        self._needs_joints = settings.flag('require_joint_states') or self._from_joints

    def enable(self, enabled: bool) -> None:
        """Let the reference be followed or not; enabling ends a stop."""
        self.enabled = enabled
        self.stopped = self.stopped and not enabled

    def trouble(
        self, joint_age: float, has_posture: bool, given: bool, reference_age: float
    ) -> str:
        """Return why the reference may not be followed, '' if it may.

        Parameters
        ----------
        joint_age : float
            Age of the last good joint state [s]; infinite if there is none.
        has_posture : bool
            Whether it is one that the model can have.
        reference_age : float
            Of the last streamed point [s]; 0 for a trajectory.
        """
        if self.stopped:
            return 'stopped'
        if not self.enabled:
            return 'disabled'
        if self._needs_joints:
            if joint_age > self._joint_timeout:
                return STALE_JOINTS if joint_age < math.inf else NO_JOINTS
            if not has_posture:
                return 'joint_states have no posture'
        if not given:
            return 'no reference yet'
        if reference_age > self.reference_timeout:
            return 'stale reference'
        return ''
