"""Starts a launch file as `ros2 launch` does, until it is interrupted: FILE NAME:=VALUE ..."""

from __future__ import annotations

import sys

from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

file, *words = sys.argv[1:]
result_of = [(name, value) for name, _, value in (word.partition(":=") for word in words)]
service = LaunchService()
included = IncludeLaunchDescription(PythonLaunchDescriptionSource(file), launch_arguments=result_of)
service.include_launch_description(LaunchDescription([included]))
raise SystemExit(service.run())
