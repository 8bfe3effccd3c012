"""mapweave as a ROS 2 package: its command, and a launch file for live maps."""
