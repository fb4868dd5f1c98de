"""Prior models: frozen estimators of depth and disparity."""
