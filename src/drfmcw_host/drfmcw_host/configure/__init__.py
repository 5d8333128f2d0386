"""Parameters and calibrations of the running nodes.

In: the nodes' own declarations over their services; texts that a user typed.
Out: typed values, a change or the node's reason against it, a parameter file, two calibrations side by side.
"""
