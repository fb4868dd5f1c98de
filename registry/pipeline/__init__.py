"""From a YAML file to a checked pipeline, and to its components at work."""
