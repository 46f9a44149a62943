"""Everything that is drawn: training curves, films, and pages with their tables and figures."""
