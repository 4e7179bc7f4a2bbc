"""Long work as tasks: one after another in this process, or spread over a cluster, with the same results."""
