"""`python -m fvslam_graph` is `fvslam`."""

from fvslam_graph.cli import main

main()
