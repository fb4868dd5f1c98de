"""The verbs that train many runs for one table."""
