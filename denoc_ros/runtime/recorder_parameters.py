"""The recorder's parameters."""

from __future__ import annotations

from denoc_ros.bags.background import QUEUE_BYTES
from denoc_ros.bags.storage import COMPRESSIONS
from denoc_ros.runtime.parameters import Kind, Parameter, ParameterTable
from denoc_ros.runtime.shared_parameters import lifecycle_parameters

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        Parameter(
            'output',
            Kind.STRING,
            '',
            'bag folder to make, must not exist; a later recording of the same process gets `_2`, '
            '`_3`, ...; empty: `recording_` and the time',
        ),
        Parameter(
            'topics',
            Kind.STRINGS,
            [],
            'names, or patterns with `*`, of the topics to record; empty: all but hidden ones',
        ),
        Parameter(
            'urdf_path',
            Kind.STRING,
            '',
            'file of the robot to attach; empty: what `robot_description` publishes',
        ),
        Parameter(
            'compression',
            Kind.STRING,
            'zstd',
            'of the chunks',
            choices=tuple(COMPRESSIONS),
        ),
        Parameter(
            'flush_period',
            Kind.DOUBLE,
            0.2,
            'most that a kill of the process loses',
            's',
            maximum=60.0,
            positive=True,
        ),
        Parameter(
            'max_bag_size', Kind.INTEGER, 0, 'size that starts a new file; 0: none', 'bytes', 0
        ),
        Parameter(
            'max_bag_duration', Kind.DOUBLE, 0.0, 'time in one file; 0: no bound', 's', 0.0, 1e9
        ),
        Parameter(
            'queue_size',
            Kind.INTEGER,
            20000,
            'messages that may wait for the disk; more are lost, and counted',
            '',
            1,
        ),
        Parameter(
            'queue_bytes',
            Kind.INTEGER,
            QUEUE_BYTES,
            'memory that messages may take that wait for the disk; more are lost, and counted',
            'bytes',
            1,
        ),
        Parameter(
            'min_free_space',
            Kind.INTEGER,
            64 << 20,
            'the recording ends, whole, before the disk has less',
            'bytes',
            0,
        ),
    ]
)
