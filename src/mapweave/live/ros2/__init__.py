"""A robot whose ROS 2 runs rmw_zenoh, joined without ROS: its scans in, its map, poses and transforms back."""
