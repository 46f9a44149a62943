"""Command lines: overrides, errors in one line, threads."""
