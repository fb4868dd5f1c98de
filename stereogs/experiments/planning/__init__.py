"""Read ablation and matrix files and list the runs to train."""
