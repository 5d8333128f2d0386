"""The file formats, one module each; a module in this room is found by itself.

In: paths and the options of one format. Out: `Source`, the file's numbers as an array that is read piece by piece, and
the settings that the file itself states.
"""
