"""Where the crane stands.

In: the range of a pair, where its antennas are. Out: position along the rail; pose, joint state and frames (REP 105).
"""
