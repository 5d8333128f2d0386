"""Launch files, parameter files and the processes of a whole graph."""
