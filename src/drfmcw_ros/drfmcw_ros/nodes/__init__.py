"""What every node is made of: its parameters, its diagnostics, its life cycle, and its life as a process.

In: declared settings, a node, transitions. Out: ROS parameters and their tables, `/diagnostics`, an exit status.
"""
