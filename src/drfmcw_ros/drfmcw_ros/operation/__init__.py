"""Processes that run for weeks, and that only their own may talk to.

In: the environment that a service manager or SROS2 sets, the names of stations and pairs.
Out: signs of life, a refusal to pretend security that is not there, policies and keystores.
"""
