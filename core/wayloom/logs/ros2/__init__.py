"""ROS 2 recordings in MCAP: index, CDR messages, rig, sensors, reader and writer."""
