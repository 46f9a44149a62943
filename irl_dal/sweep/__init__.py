"""Many runs together: one result per run, their statistics, table, figures and page."""
