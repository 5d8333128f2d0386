"""What every command line shares: one line for a wrong input, a quiet end, configuration files, pages, versions.

In: the words of a command line. Out: parsed arguments, an exit status, files written whole.
"""
