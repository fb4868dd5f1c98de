"""`stereogs models`: the networks that pipelines, metrics and the documentation name."""
