"""What decides in operation: which mode, whose turn, which value holds at a stamp, what a message may hold.

In: distances, rates of pairs, stamps, messages. Out: a mode, a frame of slots, a value, or the reason of a refusal.
"""
