"""Nodes that run for weeks, that wait for a supervisor, and that only their own may talk to.

In: the environment that a service manager or SROS2 sets, transitions, the names of stations and pairs.
Out: signs of life, nodes with a life cycle, a refusal to pretend security that is not there, policies and keystores.
"""
