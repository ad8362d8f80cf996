"""Write and read rosbag2 recordings made from the journal."""
