"""Grids of runs: sequences x modes x settings x seeds, in parallel, kept, compared and reported."""

from fvslam_graph.core.extras import require

require("study")  # here, as its tables are all through the package, and its report comes after hours
