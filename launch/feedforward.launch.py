"""The feedforward node on a robot: ros2 launch denoc_ros feedforward.launch.py urdf:=ROBOT."""

from __future__ import annotations

from typing import Any


def generate_launch_description() -> Any:
    """Return the launch description (launch is imported here: pip installs do not have it)."""
    from launch.actions import DeclareLaunchArgument
    from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
    from launch_ros.actions import LifecycleNode
    from launch_ros.substitutions import FindPackageShare

    from launch import LaunchDescription

    defaults = PathJoinSubstitution([FindPackageShare('denoc_ros'), 'config', 'feedforward.yaml'])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'urdf', default_value='', description='file; empty: the topic robot_description'
            ),
            DeclareLaunchArgument('params', default_value=defaults, description='parameters'),
            LifecycleNode(
                package='denoc_ros',
                executable='feedforward',
                name='feedforward',
                namespace='',
                output='screen',
                parameters=[
                    LaunchConfiguration('params'),
                    {'urdf_path': LaunchConfiguration('urdf')},
                ],
            ),
        ]
    )
