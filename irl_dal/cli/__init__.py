"""Command lines: what has to be installed, overrides, errors in one line, threads."""
