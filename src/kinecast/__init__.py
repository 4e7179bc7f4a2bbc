"""kinecast."""
