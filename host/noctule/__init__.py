"""Noctule on the host: the `noctule` command, run reports, benches and the generators of interface code."""
