"""The mapper with its topics, and on demand a recording that is then played, and RViz."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessIO
from launch.substitutions import (
    AndSubstitution, EqualsSubstitution, LaunchConfiguration, NotSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

TOPICS = {'labels': ('semantic/image', 'label images'),
          'depth': ('depth/image', 'depth images'),
          'camera_info': ('depth/camera_info', 'intrinsics of the depth images'),
          'pose': ('pose', 'poses of the camera or body'),
          'color': ('color/image', 'colour images, for the overlay')}


def generate_launch_description():
    """Return the description; `ros2 launch persem_ros mapper.launch.py --show-args` lists all."""
    share = FindPackageShare('persem_ros')
    given = {name: LaunchConfiguration(name) for name in (
        'config', 'namespace', 'voxel_size', 'pose_source', 'map_path', 'bag', 'rate', 'loop',
        'rviz', 'rviz_config', *TOPICS)}
    played = NotSubstitution(EqualsSubstitution(given['bag'], ''))
    arguments = [
        DeclareLaunchArgument('config', default_value=PathJoinSubstitution(
            [share, 'config', 'persem.yaml']), description='settings in a YAML file'),
        DeclareLaunchArgument('namespace', default_value='', description='namespace of the node'),
        DeclareLaunchArgument('voxel_size', default_value='0.5',
                              description='edge of a voxel, metres'),
        DeclareLaunchArgument('pose_source', default_value='topic', choices=['topic', 'tf'],
                              description='poses from a topic or from /tf'),
        DeclareLaunchArgument('map_path', default_value='',
                              description='map file of ~/save_map and ~/load_map'),
        DeclareLaunchArgument('bag', default_value='', description='recording to play'),
        DeclareLaunchArgument('rate', default_value='1.0', description='speed of the recording'),
        DeclareLaunchArgument('loop', default_value='false', choices=['true', 'false'],
                              description='whether the recording is played again and again'),
        DeclareLaunchArgument('rviz', default_value='false', choices=['true', 'false'],
                              description='whether RViz is opened'),
        DeclareLaunchArgument('rviz_config', default_value=PathJoinSubstitution(
            [share, 'config', 'persem.rviz']), description='what RViz shows'),
        *(DeclareLaunchArgument(name, default_value=topic, description=text)
          for name, (topic, text) in TOPICS.items())]
    mapper = Node(
        package='persem_ros', executable='mapper', namespace=given['namespace'], output='screen',
        parameters=[given['config'], {
            'memory.voxel_size': ParameterValue(given['voxel_size'], value_type=float),
            'pose.source': ParameterValue(given['pose_source'], value_type=str),
            'map.path': ParameterValue(given['map_path'], value_type=str),
            **{f'topics.{name}': ParameterValue(given[name], value_type=str) for name in TOPICS}}])
    # The delay lets the node find the publishers: what is sent before that is lost.
    words = ['ros2', 'bag', 'play', given['bag'], '--rate', given['rate'], '--delay', '3']
    players = [ExecuteProcess(cmd=words + extra, output='screen', condition=IfCondition(
        AndSubstitution(played, condition))) for extra, condition in (
            ([], NotSubstitution(given['loop'])), (['--loop'], given['loop']))]
    rviz = Node(package='rviz2', executable='rviz2', arguments=['-d', given['rviz_config']],
                condition=IfCondition(given['rviz']))
    begin = once_ready(players)
    playing = RegisterEventHandler(OnProcessIO(target_action=mapper, on_stdout=begin,
                                               on_stderr=begin))
    # RViz first: where it is not installed the launch ends there, and would leave a mapper behind.
    return LaunchDescription([*arguments, rviz, playing, mapper])


def once_ready(actions):
    """Return a handler that begins *actions* when the node says that it is ready."""
    waiting = list(actions)

    def begin(event):
        lines = event.text.decode(errors='replace').splitlines()
        if not any(line.endswith(': ready') for line in lines):
            return None
        found, waiting[:] = list(waiting), []
        return found
    return begin
