"""How good a trajectory is: metrics, tables and plots."""
