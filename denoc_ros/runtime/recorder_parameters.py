"""The recorder's parameters."""

from __future__ import annotations

from denoc_ros.bags.background import QUEUE_BYTES
from denoc_ros.bags.storage import COMPRESSIONS
from denoc_ros.runtime.parameters import ParameterTable
from denoc_ros.runtime.shared_parameters import lifecycle_parameters, priority_parameter
from denoc_ros.settings import Kind, Parameter

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        Parameter(
            'output',
            Kind.STRING,
            '',
            'bag folder to create, must not exist; later recordings of the same process get '
            '`_2`, `_3`, ...; empty: `recording_` and the time; a change counts from the next '
            '`~/start` on',
            live=True,
        ),
        Parameter(
            'topics',
            Kind.STRINGS,
            [],
            'topics to record, as names or patterns with `*`; empty: all but hidden ones',
        ),
        Parameter(
            'urdf_path',
            Kind.STRING,
            '',
            'URDF file of the robot to attach; empty: the one published on `robot_description`',
        ),
        Parameter(
            'compression',
            Kind.STRING,
            'zstd',
            'compression of the chunks',
            choices=tuple(COMPRESSIONS),
        ),
        Parameter(
            'flush_period',
            Kind.DOUBLE,
            0.2,
            'period at which the open chunk is written; a kill of the process loses no more '
            'than that',
            's',
            maximum=60.0,
            positive=True,
        ),
        Parameter(
            'max_bag_size',
            Kind.INTEGER,
            0,
            'file size at which a new file starts; 0: no limit',
            'bytes',
            0,
        ),
        Parameter(
            'max_bag_duration',
            Kind.DOUBLE,
            0.0,
            'duration of a file after which a new one starts; 0: no limit',
            's',
            0.0,
            1e9,
        ),
        Parameter(
            'queue_size',
            Kind.INTEGER,
            20000,
            'largest number of messages that wait for the disk; further messages are lost and '
            'counted',
            '',
            1,
        ),
        Parameter(
            'queue_bytes',
            Kind.INTEGER,
            QUEUE_BYTES,
            'largest memory of the messages that wait for the disk; further messages are lost '
            'and counted',
            'bytes',
            1,
        ),
        Parameter(
            'min_free_space',
            Kind.INTEGER,
            64 << 20,
            'free space at which the recording ends, with a complete file',
            'bytes',
            0,
        ),
        priority_parameter('SCHED_FIFO priority of all threads, where allowed; 0 = off'),
    ]
)
