"""Storage files of recordings: MCAP and SQLite, written so that nothing is lost, read whole, cut off or damaged.

In: a path. Out: topics and messages, what is damaged and what is missing; or a file.
"""
