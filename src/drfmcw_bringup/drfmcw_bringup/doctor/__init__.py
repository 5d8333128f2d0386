"""What keeps a graph from working on this machine.

In: the environment, this machine, the running graph, parameter files and scenarios.
Out: findings, one line each: OK, WARN or ERROR, and what to do.
"""
