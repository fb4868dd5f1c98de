"""Analysis of a scene: its kind, its plain background, and depths that its views contradict."""
