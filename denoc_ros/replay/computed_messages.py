"""The messages of a replay: computed values, row by row."""

from __future__ import annotations

from collections.abc import Iterator

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.estimation.torque_along import Torques
from denoc_ros.replay.settings import PREFIX
from denoc_ros.replay.stream import Block
from denoc_ros.types import Array

Message = tuple[int, str, bytes]  # log time, topic, CDR


def encoded(
    block: Block, torques: Torques, encoders: dict[str, JointStateMessage]
) -> Iterator[Message]:
    """Yield a block's messages, row by row."""
    motion = (block.motion.q, block.motion.qd)
    values: dict[str, tuple[Array, ...]] = {
        f'{PREFIX}{model}/effort': (*motion, torque) for model, torque in torques.models.items()
    }
    if torques.deflection is not None:
        values[f'{PREFIX}tip_deflection'] = tuple(torques.deflection)
    if torques.modal is not None:
        values[f'{PREFIX}modal_state'] = tuple(torques.modal)
    for k, (stamp_ns, log_ns) in enumerate(
        zip(block.stamp_ns.tolist(), block.log_ns.tolist(), strict=True)
    ):
        for topic, encoder in encoders.items():
            yield log_ns, topic, encoder.encode(stamp_ns, *(part[k] for part in values[topic]))
