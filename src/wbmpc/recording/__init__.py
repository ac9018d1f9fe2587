"""Recordings of runs: one MCAP file with ROS 2 messages, written while the run goes on, and read again."""
