"""The recorder's parameters."""

from __future__ import annotations

from denoc_ros.bags.background import QUEUE_BYTES
from denoc_ros.bags.storage import COMPRESSIONS
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import AUTOSTART, priority_parameter
from denoc_ros.settings import Kind, parameter

TABLE = ParameterTable(
    [
        AUTOSTART,
        parameter(
            'output',
            '',
            'bag folder to create, must not exist; later recordings of the same process get '
            '`_2`, `_3`, ...; empty: `recording_` and the time; a change counts from the next '
            '`~/start` on',
            live=True,
        ),
        parameter(
            'topics',
            Kind.STRINGS,
            'topics to record, as names or patterns with `*`; empty: all but hidden ones',
        ),
        parameter(
            'urdf_path',
            '',
            'URDF file of the robot to attach; empty: the one published on `robot_description`',
        ),
        parameter('compression', 'zstd', 'compression of the chunks', choices=tuple(COMPRESSIONS)),
        parameter(
            'flush_period',
            0.2,
            'period at which the open chunk is written; a kill of the process loses no more '
            'than that',
            's',
            maximum=60.0,
            positive=True,
        ),
        parameter(
            'max_bag_size', 0, 'file size at which a new file starts; 0: no limit', 'bytes', 0
        ),
        parameter(
            'max_bag_duration',
            0.0,
            'duration of a file after which a new one starts; 0: no limit',
            's',
            0.0,
            1e9,
        ),
        parameter(
            'queue_size',
            20000,
            'largest number of messages that wait for the disk; further messages are lost and '
            'counted',
            '',
            1,
        ),
        parameter(
            'queue_bytes',
            QUEUE_BYTES,
            'largest memory of the messages that wait for the disk; further messages are lost '
            'and counted',
            'bytes',
            1,
        ),
        parameter(
            'min_free_space',
            64 << 20,
            'free space at which the recording ends, with a complete file',
            'bytes',
            0,
        ),
        priority_parameter('SCHED_FIFO priority of all threads, where allowed; 0 = off'),
    ]
)
