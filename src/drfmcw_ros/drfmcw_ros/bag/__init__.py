"""Recordings: reading and writing rosbag2 files, recording the graph, playing into it, saying what a file holds.

In: a path, or the topics of a graph. Out: messages with their time, or a recording.
"""
