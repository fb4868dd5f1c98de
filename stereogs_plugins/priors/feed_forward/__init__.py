"""Networks that return cameras and depth, or whole Gaussians, of photographs."""
