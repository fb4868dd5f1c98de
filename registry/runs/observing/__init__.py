"""Who is told how training goes: a terminal, metrics.jsonl, and the pipeline's observers."""
