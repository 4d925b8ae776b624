"""Plant, predictor, feedforward and recorder on one robot, as `denoc up` starts them."""

from __future__ import annotations

from typing import Any

NODES = ('recorder', 'plant', 'predictor', 'feedforward')
WITH_ROBOT = ('plant', 'predictor', 'feedforward')


def generate_launch_description() -> Any:
    """Return the launch description (launch is imported here: pip installs do not have it)."""
    from launch.actions import DeclareLaunchArgument
    from launch.substitutions import LaunchConfiguration
    from launch_ros.actions import LifecycleNode

    from launch import LaunchDescription

    urdf, rate = LaunchConfiguration('urdf'), LaunchConfiguration('update_rate')
    output = LaunchConfiguration('output')
    robot = {'urdf_path': urdf, 'update_rate': rate}
    return LaunchDescription(
        [
            DeclareLaunchArgument('urdf', description='file of the robot'),
            DeclareLaunchArgument('update_rate', default_value='1000.0', description='Hz'),
            DeclareLaunchArgument('output', default_value='run', description="the bag's folder"),
            *(
                LifecycleNode(
                    package='denoc_ros',
                    executable=name,
                    name=name,
                    namespace='',
                    output='screen',
                    parameters=[robot if name in WITH_ROBOT else {'output': output}],
                )
                for name in NODES
            ),
        ]
    )
