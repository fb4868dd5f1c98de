"""Scene loaders: photographs and cameras in, a `Scene` out."""
