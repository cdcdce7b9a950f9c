"""Grids of runs: sequences x modes x settings x seeds, in parallel, kept, compared and reported."""
