"""What cameras and reconstructions say: lenses, poses, depth bounds, COLMAP models, tracks of points."""
