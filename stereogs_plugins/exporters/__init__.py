"""Exporters: write the trained Gaussians, the cameras or a video to files."""
