"""Priors: frozen estimators of depth, disparity, optical flow and matches."""
