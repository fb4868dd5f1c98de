"""What a plugin is and what it is given: component classes, scenes, steps, hooks, and checks."""
