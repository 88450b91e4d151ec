"""The verbs of the command line, a file each; heavy imports stay inside the functions."""
