from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    config = Path(get_package_share_directory("mapshift_node")) / "config" / "mapshift.yaml"
    return LaunchDescription([
        DeclareLaunchArgument("config", default_value=str(config), description="Parameters of the node"),
        Node(package="mapshift_node", executable="mapshift_node", parameters=[LaunchConfiguration("config")],
             respawn=True, respawn_delay=2.0),
    ])
