"""Where the runs of an ablation or a bench are trained."""
