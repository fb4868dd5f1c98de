"""What a run that leaves the choice to the host is given: a pipeline for its scene, a length for its time."""
