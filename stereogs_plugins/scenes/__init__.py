"""Scene loaders: from photographs and cameras to a `Scene`."""
